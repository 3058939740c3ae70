"""Fits and comparisons as plain records, for summary.json."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from bayes_greybox.criticism.convergence import Verdict, convergence
from bayes_greybox.criticism.cross_validation.compare import unreliable
from bayes_greybox.criticism.discrepancy import discrepancy_table
from bayes_greybox.criticism.inclusion import inclusion
from bayes_greybox.criticism.trial import Trial
from bayes_greybox.equations.of_posterior import fitted_system
from bayes_greybox.inference.kept.netcdf import versions
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.report.equations.record import equations_record
from bayes_greybox.running.plain_values import plain_rows, plain_values


def run_record(
    fit: Posterior, sampling: Mapping[str, Any], seconds: float, held_out: pd.Series | None, tried: Trial | None = None
) -> dict[str, Any]:
    """Return verdict, equations, coefficients, discrepancy, errors, data, settings, time and versions of a fit.

    `held_out` is its normalised mean squared error on held-out data by equation, `tried` its free run.
    """
    data = fit.data
    return {
        "verdict": verdict_record(convergence(fit)),
        "equations": equations_record(fitted_system(fit)),
        "coefficients": plain_rows(inclusion(fit)),
        "discrepancy": plain_rows(discrepancy_table(fit)),
        "held_out_nmse": None if held_out is None else plain_values(held_out.to_dict()),
        "free_run": None if tried is None else _free_run(tried),
        "data": {
            "rows": fit.n_obs,
            **({} if fit.whole is None else {"looked_at": data.n_obs}),
            "of": fit.model.rows.in_words(data),
            "runs": data.n_run,
            "dropped": data.dropped,
        },
        "sampling": dict(sampling),
        "seconds": round(seconds, 3),
        "versions": versions(),
    }


def comparison_record(
    fits: Mapping[str, Posterior], table: pd.DataFrame, sampling: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Return a comparison, models whose Pareto k is too large, the verdict of each fit, settings and versions.

    `sampling` is None for saved fits.
    """
    record: dict[str, Any] = {
        "comparison": plain_rows(table),
        "scheme": {key: table.attrs.get(key) for key in ("scheme", "block", "folds", "threshold")},
        "unreliable": unreliable(table),
        "notes": list(table.attrs.get("notes", [])),
        "verdicts": {name: verdict_record(convergence(fit)) for name, fit in fits.items()},
        "versions": versions(),
    }
    return record if sampling is None else {**record, "sampling": dict(sampling)}


def verdict_record(verdict: Verdict) -> dict[str, Any]:
    """Return whether the sampler can be trusted, with the reasons why not."""
    return {"ok": bool(verdict.ok), "short": bool(verdict.short), "reasons": list(verdict.reasons)}


def write_json(path: Path, record: Mapping[str, Any]) -> None:
    """Write a record; numbers that are not finite become null, which JSON lacks otherwise."""
    path.write_text(json.dumps(record, indent=2, allow_nan=False, ensure_ascii=False) + "\n", encoding="utf-8")


def _free_run(tried: Trial) -> dict[str, Any]:
    if tried.run is None:
        return {"of": None, "why": tried.why}
    return {
        "of": "held-out data" if tried.held_out else "training data",
        "nrmse": plain_values(tried.run.nrmse().to_dict()),
    }
