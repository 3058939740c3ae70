"""Shape and type checks of the whole package, switched on for the test run only."""

import os

import matplotlib
from jaxtyping import install_import_hook

matplotlib.use("Agg")
if os.environ.get("BAYES_GREYBOX_TYPECHECK", "1") == "1":
    install_import_hook("bayes_greybox", "beartype.beartype")
