#!/bin/sh
# Builds the tracker where it is not built, as in a fresh checkout, and runs it.
make -s tracker >&2 && exec ./tracker "$@"
