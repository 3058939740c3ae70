"""Models of the same data side by side: predictive densities, their differences, stacking weights."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.optimize import minimize

from bayes_greybox.data.errors import InputError
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.model.program import measured_rate

from .convergence import convergence
from .loo import Loo, loo
from .pointwise import count_observations

SCHEMES = {"loo": loo}
"""Cross-validation schemes by name; each gives a `Loo` of a posterior."""

TIE_NATS = 4.0
"""Differences smaller than this say little, whatever their standard error (Sivula et al. 2020)."""


def compare(
    fits: Mapping[str, Posterior],
    scheme: str = "loo",
    *,
    at_most: int | None = None,
    max_refits: int = 10,
    progress: bool = True,
) -> pd.DataFrame:
    """Compare models by cross-validation, from one run each.

    Args:
        fits: Fits by name, all to the same data.
        scheme: "loo": leave out one observation at a time.
        at_most: Thin each model's draws evenly to this many; None: all.
        max_refits: Exact refits of flagged observations for each model; a model that needs more gets none.
        progress: Whether refits of flagged observations show their progress.

    Returns:
        A table indexed by name, best first: elpd and se (nats), elpd_diff (elpd less that of the best model,
        ≤ 0) and diff_se (from the pointwise differences), p_eff, weight (stacking), worst_k (largest Pareto k
        among observations that were not refitted) and refits. `table.attrs["notes"]` lists what to beware of.

    Raises:
        InputError: Fewer than two models; an unknown scheme; fits to different data or different equations.
    """
    if scheme not in SCHEMES:
        raise InputError(
            f"compare(scheme={scheme!r}) is not known: the one there is is {', '.join(map(repr, SCHEMES))}."
        )
    if len(fits) < 2:
        raise InputError(f"compare needs at least two models, not {len(fits)}: pass {{'name': fit, 'other': fit}}.")
    _require_same_data(fits)
    results = {
        name: SCHEMES[scheme](fit, at_most, max_refits=max_refits, progress=progress) for name, fit in fits.items()
    }
    return comparison_table(results, _verdict_notes(fits))


def comparison_table(results: Mapping[str, Loo], notes: tuple[str, ...] = ()) -> pd.DataFrame:
    """The table of `compare` from cross-validation results over the same observations."""
    pointwise = np.column_stack([result.pointwise for result in results.values()])
    total = pointwise.sum(axis=0)
    best = int(np.argmax(total))
    difference = pointwise - pointwise[:, [best]]
    table = pd.DataFrame(
        {
            "elpd": total,
            "se": [result.se for result in results.values()],
            "elpd_diff": np.minimum(difference.sum(axis=0), 0.0),
            # SE of a sum of n differences: √(n var)
            "diff_se": np.sqrt(len(difference) * difference.var(axis=0, ddof=1)),
            "p_eff": [result.p_eff for result in results.values()],
            "weight": stacking_weights(pointwise),
            "worst_k": [result.worst_k for result in results.values()],
            "refits": [result.refits for result in results.values()],
        },
        index=pd.Index(results, name="model"),
    )
    table = table.sort_values("elpd", ascending=False, kind="stable")
    table.attrs["notes"] = [
        *notes,
        *(f"{name}: {note}" for name, result in results.items() for note in result.notes),
        *_tie_notes(table),
    ]
    return table


def stacking_weights(pointwise: Float[np.ndarray, "n_obs n_model"]) -> Float[np.ndarray, " n_model"]:
    """Weights of the mixture that predicts best: max_w Σ_i log Σ_k w_k exp(elpd_ik) over the simplex.

    Yao, Vehtari, Simpson & Gelman 2018, Eq. 6. The problem is concave; its gradient is Σ_i p_ik / Σ_j w_j
    p_ij.

    Args:
        pointwise: elpd of each observation under each model, nats.
    """
    # Each row's scale is free; with the largest at one nothing overflows.
    density = np.exp(pointwise - pointwise.max(axis=1, keepdims=True))
    n_model = density.shape[1]

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        mixture = np.maximum(density @ w, 1e-300)
        return -float(np.mean(np.log(mixture))), -np.mean(density / mixture[:, None], axis=0)

    result = minimize(
        loss,
        np.full(n_model, 1 / n_model),
        jac=True,
        method="SLSQP",
        bounds=[(0.0, 1.0)] * n_model,
        constraints={"type": "eq", "fun": lambda w: w.sum() - 1, "jac": lambda w: np.ones_like(w)},
        options={"ftol": 1e-12, "maxiter": 1000},
    )
    weights = np.clip(result.x, 0.0, None)
    return weights / weights.sum()


def _require_same_data(fits: Mapping[str, Posterior]) -> None:
    (first, reference), *others = fits.items()
    for name, fit in others:
        pair = f"compare: {first!r} and {name!r} were fitted to different data"
        remedy = "fit all models to the same data."
        if set(fit.model.equations) != set(reference.model.equations):
            raise InputError(
                f"compare: {first!r} learns {', '.join(reference.model.equations)} but {name!r} learns "
                f"{', '.join(fit.model.equations)}; compare models of the same equations."
            )
        if fit.data.n_obs != reference.data.n_obs:
            raise InputError(f"{pair}: {reference.data.n_obs} rows against {fit.data.n_obs}; {remedy}")
        columns = {"time": (reference.data.time, fit.data.time)} | {
            f"the derivative of {equation!r}": (
                measured_rate(reference.data, equation),
                measured_rate(fit.data, equation),
            )
            for equation in reference.model.equations
        }
        for what, (one, other) in columns.items():
            if not np.allclose(one, other, rtol=1e-9, atol=1e-9 * np.abs(one).max()):
                worst = float(np.abs(one - other).max())
                raise InputError(f"{pair}: {what} differs by up to {worst:.3g}; {remedy}")
        for equation in reference.model.equations:
            if count_observations(fit, equation) != count_observations(reference, equation):
                raise InputError(
                    f"{pair}: the derivatives of {equation!r} come from different differentiators; {remedy}"
                )


def _verdict_notes(fits: Mapping[str, Posterior]) -> tuple[str, ...]:
    verdicts = {name: convergence(fit) for name, fit in fits.items()}
    return tuple(
        f"{name} has not converged, so its elpd is not reliable: {verdict.reasons[0]}"
        for name, verdict in verdicts.items()
        if not verdict.ok
    )


def _tie_notes(table: pd.DataFrame) -> list[str]:
    best, second = table.index[:2]
    gap, se = -float(table["elpd_diff"].iloc[1]), float(table["diff_se"].iloc[1])
    if gap >= max(TIE_NATS, 2 * se):
        return []
    reason = f"less than {TIE_NATS:g} nats" if gap < TIE_NATS else f"less than twice its standard error of {se:.1f}"
    return [f"{best} and {second} differ by {gap:.1f} nats, {reason}: the data do not tell them apart."]
