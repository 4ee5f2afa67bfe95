#!/usr/bin/env bash
# Package: foxglove-sdk 0.30.3 beside the reader of mcap 1.6.0.
# Expected: two MCAP files open at once hold what was logged for each; a time of 4.35 s is 4 s and 350,000,000
#   ns.
# Seen: channels and writers belong to one global context unless each gets a Context of its own, so both files
#   hold every message of both runs, on one topic. Timestamp.from_epoch_secs cuts instead of rounding: 4.35 s
#   becomes 4 s and 349,999,999 ns.
# Why it matters: a study that logs two trials at a time writes two equal files with both trials' boxes mixed,
#   and nothing warns; a frame found again by its time in seconds is missed by a nanosecond. Pass context= to
#   both, and integer nanoseconds.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps foxglove-sdk==0.30.3 mcap==1.6.0 lz4==4.4.5 zstandard==0.25.0
"$work/venv/bin/python" - "$work" <<'EOF'
import sys
from pathlib import Path

import foxglove
from foxglove import Channel, Context
from foxglove.messages import Timestamp
from mcap.reader import make_reader


def logged(folder, contexts):
    """Number of messages in each of two files that are open at once and logged to once each."""
    folder.mkdir()
    files = [folder / f"{name}.mcap" for name in "ab"]
    writers = [foxglove.open_mcap(file, **context) for file, context in zip(files, contexts)]
    for k, context in enumerate(contexts):
        Channel("/tracks", message_encoding="json", **context).log({"trial": k}, log_time=5)
    for writer in writers:
        writer.close()
    counts = []
    for file in files:
        with file.open("rb") as stream:
            counts.append(len(list(make_reader(stream).iter_messages())))
    return counts


work = Path(sys.argv[1])
shared = logged(work / "shared", [{}, {}])
apart = logged(work / "apart", [{"context": Context()}, {"context": Context()}])
print("messages in each file, one logged to each: by default", shared, "with a context each", apart)
assert shared == [2, 2]
assert apart == [1, 1]
stamp = Timestamp.from_epoch_secs(4.35)
print("4.35 s is", stamp.sec, "s and", stamp.nsec, "ns")
assert (stamp.sec, stamp.nsec) == (4, 349_999_999)
EOF
