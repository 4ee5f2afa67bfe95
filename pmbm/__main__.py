"""`python -m pmbm`: the command line, where its script is not on the path."""

import os
import sys

if __name__ == "__main__":
    # `python -m` puts the current folder before everything else on the import path.
    here = os.getcwd()
    if not sys.flags.safe_path and here != os.path.dirname(os.path.dirname(__file__)):
        sys.path.remove(here)

    from pmbm.cli import main

    main()
