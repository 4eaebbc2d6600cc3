"""`python -m stepcore`: the command line."""

import sys

from stepcore.cli import main

sys.exit(main())
