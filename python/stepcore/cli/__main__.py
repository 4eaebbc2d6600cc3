"""`python -m stepcore.cli`."""

import sys

from stepcore.cli import main

if __name__ == "__main__":
    sys.exit(main())
