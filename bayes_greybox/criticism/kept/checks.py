"""Checks in a saved fit, so that its page need not make them again."""

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

KEPT = "checks"
"""Root attribute of a saved fit that holds its checks, as JSON text."""

FORMAT = 1
"""Of that text; of another one nothing is read, and the checks are made again."""


def kept_checks(posterior: Posterior) -> dict[str, str]:
    """Attributes of a file with the checks of a posterior, where they were made.

    Args:
        posterior: Fitted model.
    """
    found = recall(posterior, checks)
    if found is None:
        return {}
    record = {
        "format": FORMAT,
        "of": made_by(posterior),
        "ok": found.ok,
        "reasons": found.reasons,
        "table": _columns(found.table),
        "loo_pit": {name: _plain(asdict(each)) for name, each in found.loo_pit.items()},
        "whiteness": {name: _plain(asdict(each)) for name, each in found.whiteness.items()},
        "sensitivity": _columns(found.sensitivity),
    }
    return {KEPT: json.dumps(record)}


def restore_checks(posterior: Posterior) -> None:
    """Have a posterior that was read from a file know the checks that the file has, if they are its own.

    Args:
        posterior: With all root attributes of the file.
    """
    text = posterior.idata.attrs.pop(KEPT, None)
    record = {} if text is None else json.loads(text)
    # Draws that somebody thinned or changed since have other checks, and so may have another version of the package.
    if record.get("format") != FORMAT or record.get("of") != made_by(posterior):
        return
    found = Checks(
        record["ok"],
        tuple(record["reasons"]),
        _table(record["table"]),
        {name: LooPit(**_arrays(each, "row", "value")) for name, each in record["loo_pit"].items()},
        {name: _whiteness(each) for name, each in record["whiteness"].items()},
        _table(record["sensitivity"]),
    )
    remember(posterior, checks, found)


def made_by(posterior: Posterior) -> list[Any]:
    """What was found out is of: the version of the package that did, and the draws.

    Args:
        posterior: Fitted model.
    """
    return [version("bayes-greybox"), draws_sum(posterior)]


def draws_sum(posterior: Posterior) -> int:
    """A sum of the bytes of all draws: what was found out about a posterior is of these and of no others.

    Args:
        posterior: Fitted model.
    """
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
    """A table by column, its index first, and how many columns that has."""
    whole = table.reset_index()
    return {"index": table.index.nlevels, "columns": {name: whole[name].tolist() for name in whole}}


def _table(record: Mapping[str, Any]) -> pd.DataFrame:
    whole = pd.DataFrame(record["columns"])
    return whole.set_index(list(whole.columns[: record["index"]]))
