"""`python -m bayes_greybox` is the command `bayes-greybox`."""

import sys

from bayes_greybox.cli import command

if __name__ == "__main__":
    sys.exit(command())
