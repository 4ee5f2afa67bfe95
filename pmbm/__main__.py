"""`python -m pmbm`: the command line, where its script is not on the path."""

from pmbm.cli import main

if __name__ == "__main__":
    main()
