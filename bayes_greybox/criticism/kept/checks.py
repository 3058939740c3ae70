"""Checks and trade-offs of the plain kernel in a saved fit, so that its page need not compute them again."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.remembering import recall, remember

from ..checks.checks import Checks, checks
from ..checks.loo_pit import LooPit
from ..checks.whiteness import Whiteness
from ..trade_off import plain_trade_offs

CHECKS_ATTRIBUTE, TRADE_OFFS_ATTRIBUTE = "checks", "plain_trade_offs"
"""Root attributes of a saved fit that hold them, as JSON text."""

CHECKS_FORMAT = 1
"""Version of the checks' text; other versions are not read, and the checks are made again."""


def kept_checks(posterior: Posterior) -> dict[str, str]:
    """Return attributes of a file with the checks of a posterior, if they were made."""
    made = recall(posterior, checks)
    if made is None:
        return {}
    record = {
        "format": CHECKS_FORMAT,
        "of": origin(posterior),
        "ok": made.ok,
        "reasons": made.reasons,
        "table": _columns(made.table),
        "loo_pit": {name: _plain(asdict(each)) for name, each in made.loo_pit.items()},
        "whiteness": {name: _plain(asdict(each)) for name, each in made.whiteness.items()},
        "sensitivity": _columns(made.sensitivity),
    }
    return {CHECKS_ATTRIBUTE: json.dumps(record)}


def restore_checks(posterior: Posterior) -> None:
    """Restore the checks from the root attributes of the file, if they belong to these draws and this version."""
    text = posterior.idata.attrs.pop(CHECKS_ATTRIBUTE, None)
    record = {} if text is None else json.loads(text)
    if record.get("format") != CHECKS_FORMAT or record.get("of") != origin(posterior):
        return
    result = Checks(
        record["ok"],
        tuple(record["reasons"]),
        _table(record["table"]),
        {name: LooPit(**_arrays(each, "row", "value")) for name, each in record["loo_pit"].items()},
        {name: _whiteness(each) for name, each in record["whiteness"].items()},
        _table(record["sensitivity"]),
    )
    remember(posterior, checks, result)


def kept_trade_offs(posterior: Posterior) -> dict[str, str]:
    """Return attributes of a file with the trade-offs of the plain kernel, if they were computed."""
    table = recall(posterior, plain_trade_offs)
    if table is None:
        return {}
    return {TRADE_OFFS_ATTRIBUTE: json.dumps({"of": origin(posterior), "table": table.to_dict("index")})}


def restore_trade_offs(posterior: Posterior) -> None:
    """Restore the trade-offs of the plain kernel from the root attributes of the file, if they are of these draws."""
    text = posterior.idata.attrs.pop(TRADE_OFFS_ATTRIBUTE, None)
    record = {} if text is None else json.loads(text)
    if record.get("of") == origin(posterior):
        table = pd.DataFrame.from_dict(record["table"], orient="index", columns=["overlap", "correlation"])
        remember(posterior, plain_trade_offs, table.loc[list(posterior.sites)].astype(float))


def origin(posterior: Posterior) -> list[Any]:
    """Return the version of the package and a check sum of the draws, which results depend on."""
    return [version("bayes-greybox"), draws_sum(posterior)]


def draws_sum(posterior: Posterior) -> int:
    """Return a check sum of all draws."""
    group, total = posterior.idata["posterior"].dataset, 0
    for name in sorted(map(str, group.data_vars)):
        total = crc32(np.ascontiguousarray(group[name].to_numpy()).tobytes(), total)
    return total


def _whiteness(record: Mapping[str, Any]) -> Whiteness:
    arrays = _arrays(record, "lag", "autocorrelation", "bound")
    return Whiteness(**{**arrays, "standing_out": tuple(record["standing_out"])})


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: np.asarray(value).tolist() for name, value in values.items()}


def _arrays(values: Mapping[str, Any], *names: str) -> dict[str, Any]:
    return {name: np.array(value) if name in names else value for name, value in values.items()}


def _columns(table: pd.DataFrame) -> dict[str, Any]:
    """Return a table by column, its index first, with the number of columns of the index."""
    whole = table.reset_index()
    return {"index": table.index.nlevels, "columns": {name: whole[name].tolist() for name in whole}}


def _table(record: Mapping[str, Any]) -> pd.DataFrame:
    whole = pd.DataFrame(record["columns"])
    return whole.set_index(list(whole.columns[: record["index"]]))
