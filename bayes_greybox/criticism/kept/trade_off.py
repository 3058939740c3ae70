"""How f would trade off without orthogonality, in a saved fit: its page need not draw θ and f anew."""

import json

import pandas as pd

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.remembering import recall, remember

from ..trade_off import plain_trade_offs
from .checks import made_by

KEPT = "plain_trade_offs"
"""Root attribute of a saved fit that holds them, as JSON text."""


def kept_trade_offs(posterior: Posterior) -> dict[str, str]:
    """Attributes of a file with what the plain kernel would do, where it was found.

    Args:
        posterior: Fitted model.
    """
    found = recall(posterior, plain_trade_offs)
    if found is None:
        return {}
    return {KEPT: json.dumps({"of": made_by(posterior), "table": found.to_dict("index")})}


def restore_trade_offs(posterior: Posterior) -> None:
    """Have a posterior that was read from a file know what the file says of the plain kernel, if it is of its draws.

    Args:
        posterior: With all root attributes of the file.
    """
    text = posterior.idata.attrs.pop(KEPT, None)
    record = {} if text is None else json.loads(text)
    if record.get("of") == made_by(posterior):
        table = pd.DataFrame.from_dict(record["table"], orient="index", columns=["overlap", "correlation"])
        remember(posterior, plain_trade_offs, table.loc[list(posterior.sites)].astype(float))
