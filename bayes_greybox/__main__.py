"""`python -m bayes_greybox` is the command `bayes-greybox`."""

import sys

from bayes_greybox.cli import main

if __name__ == "__main__":
    sys.exit(main())
