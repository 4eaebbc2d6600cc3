"""`python -m stepcore`: the command line."""

import sys

from stepcore.cli import main

if __name__ == "__main__":
    sys.exit(main())
