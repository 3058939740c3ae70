"""Models of the same data side by side: predictive densities, their differences, stacking weights."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.optimize import minimize

from bayes_greybox.criticism.convergence import convergence
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.running.errors import InputError

from .cross_validate import cross_validate
from .folds import SCHEMES, START, Folds, check_scheme, make_folds
from .loo import Loo
from .weighted_rows import require_weighted_alike

__all__ = ["SCHEMES", "TIE_NATS", "compare", "comparison_table", "stacking_weights", "tied", "unreliable"]

TIE_NATS = 4.0
"""Differences smaller than this say little, whatever their standard error (Sivula et al. 2020)."""


def compare(
    fits: Mapping[str, Posterior],
    scheme: str = "loo",
    *,
    block: int | None = None,
    start: float = START,
    at_most: int | None = None,
    max_refits: int = 10,
    progress: bool = True,
) -> pd.DataFrame:
    """Compare models by cross-validation, from one run each.

    Args:
        fits: Fits by name, all to the same data.
        scheme: "loo": leave out one observation at a time; "block": contiguous rows; "trajectory": whole runs;
            "future": predict each step of time from all before it (see `cross_validate`).
        block: Rows of a block, or time stamps of a step into the future, the same for all models. None: the longest
            that any of them asks for, by the autocorrelation of what its dictionary leaves.
        start: For "future", the share of the time stamps that is only learned from.
        at_most: Thin each model's draws evenly to this many; None: all.
        max_refits: Exact refits of flagged folds for each model; a model that needs more gets none ("future": gets as
            many).
        progress: Whether refits of flagged folds show their progress.

    Returns:
        A table indexed by name, best first: elpd and se (nats), elpd_diff (elpd less that of the best model,
        ≤ 0) and diff_se (from the pointwise differences), p_eff, weight (stacking), worst_k (largest Pareto k
        among folds that were not refitted) and refits. `table.attrs` has "notes", which list what to beware of,
        "scheme", "block", "folds" (in words) and "threshold" (of Pareto k).

    Raises:
        InputError: Fewer than two models; an unknown scheme, or one that does not fit the data; fits to different data
            or different equations; fits with rows weighed by their residuals, and without.
    """
    check_scheme(scheme, block, start)
    if len(fits) < 2:
        raise InputError(f"compare needs at least two models, not {len(fits)}: pass {{'name': fit, 'other': fit}}.")
    _require_same_data(fits)
    require_weighted_alike(fits)
    chosen = ()
    if scheme in ("block", "future") and block is None:
        longest = _longest({name: make_folds(fit, scheme, None, start) for name, fit in fits.items()})
        block, chosen = longest.block, longest.notes
    order = tuple(next(iter(fits.values())).equations)
    results = {}
    for name, fit in fits.items():
        found = cross_validate(
            fit, scheme, block=block, start=start, at_most=at_most, max_refits=max_refits, progress=progress
        )
        results[name] = _in_order(found, tuple(fit.equations), order)
    return comparison_table(results, (*chosen, *_verdict_notes(fits)))


def comparison_table(results: Mapping[str, Loo], notes: tuple[str, ...] = ()) -> pd.DataFrame:
    """The table of `compare` from cross-validation results over the same folds in the same order."""
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
    table.attrs["notes"] = [*notes, *_model_notes(results), *_tie_notes(table)]
    first = next(iter(results.values()))
    table.attrs |= {"scheme": first.scheme, "block": first.block, "folds": first.words}
    table.attrs["threshold"] = min(result.threshold for result in results.values())
    return table


def tied(table: pd.DataFrame) -> list[str]:
    """Models that the data do not tell apart from the best.

    They are behind by less than `TIE_NATS` or less than twice the standard error of the difference.

    Args:
        table: What `compare` returns.
    """
    gap, se = -table["elpd_diff"].iloc[1:], table["diff_se"].iloc[1:]
    return [str(name) for name in gap.index[(gap < TIE_NATS) | (gap < 2 * se)]]


def unreliable(table: pd.DataFrame) -> list[str]:
    """Models with a Pareto k above the threshold, for which importance sampling cannot be trusted.

    Args:
        table: What `compare` returns.
    """
    return [str(name) for name in table.index[~(table["worst_k"] <= table.attrs["threshold"])]]


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
        # Of rows in chunks the data are some: those of two fits may be the same where all rows are not.
        if fit.n_obs != reference.n_obs:
            raise InputError(
                f"{pair}: {reference.n_obs:,} rows, of which some are looked at, against {fit.n_obs:,}; {remedy}"
            )
        if fit.data.run_lengths != reference.data.run_lengths:
            raise InputError(f"{pair}: the rows are divided into trajectories differently; {remedy}")
        for equation in reference.equations:
            one, other = (each.equations[equation].rows.n_row for each in (reference, fit))
            if one != other:
                raise InputError(f"{pair}: {one} rows of {equation!r} against {other}; {remedy}")
        columns = {"time": (reference.data.time, fit.data.time)} | {
            f"{_measured(reference, equation)} {equation!r}": (
                reference.equations[equation].rows.shown,
                fit.equations[equation].rows.shown,
            )
            for equation in reference.equations
        }
        for what, (one, other) in columns.items():
            if not np.allclose(one, other, rtol=1e-9, atol=1e-9 * np.abs(one).max()):
                if what != "time" and _same_samples(reference.data, fit.data):
                    raise InputError(
                        f"compare: the rows of {first!r} and {name!r} mix the same samples in different ways, each as "
                        "the model does that they are near, so that their densities are not of the same numbers: fit "
                        "both with rows=bg.TrajectoryRows(), whose rows are the samples themselves."
                    )
                worst = float(np.abs(one - other).max())
                raise InputError(f"{pair}: {what} differs by up to {worst:.3g}; {remedy}")
        for equation in reference.equations:
            if fit.equations[equation].rows.n_white != reference.equations[equation].rows.n_white:
                raise InputError(
                    f"{pair}: the derivatives of {equation!r} come from different differentiators; {remedy}"
                )


def _same_samples(one: Trajectories, other: Trajectories) -> bool:
    """Whether both are completed from samples, and from the same."""
    if one.samples is None or other.samples is None:
        return False
    pairs = [(each.matrix(each.state_names), each.state_names) for each in (one.samples, other.samples)]
    return pairs[0][1] == pairs[1][1] and np.array_equal(pairs[0][0], pairs[1][0])


def _measured(fit: Posterior, equation: str) -> str:
    """What stands before the name of an equation."""
    return "the output" if fit.equations[equation].rows.output else "the derivative of"


def _in_order(result: Loo, equations: Sequence[str], order: Sequence[str]) -> Loo:
    """The folds of the equations in another order, so that the same fold stands in the same place for all models."""
    places = [equations.index(name) for name in order]
    index = np.concatenate([np.flatnonzero(result.equation == place) for place in places])
    folds = {name: getattr(result, name)[index] for name in ("pointwise", "khat", "refitted", "row")}
    r_eff = tuple(result.r_eff[place] for place in places)
    return replace(result, **folds, equation=np.argsort(places)[result.equation[index]], r_eff=r_eff)


def _longest(folds: Mapping[str, Folds]) -> Folds:
    return max(folds.values(), key=lambda found: found.block or 0)


def _model_notes(results: Mapping[str, Loo]) -> list[str]:
    """Notes of each model under its name; what holds for all of them once."""
    shared = [note for note in next(iter(results.values())).notes if all(note in r.notes for r in results.values())]
    own = [f"{name}: {note}" for name, r in results.items() for note in r.notes if note not in shared]
    return [*(f"all models: {note}" for note in shared), *own] if len(results) > 1 else own


def _verdict_notes(fits: Mapping[str, Posterior]) -> tuple[str, ...]:
    verdicts = {name: convergence(fit) for name, fit in fits.items()}
    return tuple(
        f"{name} has not converged, so its elpd is not reliable: {verdict.reasons[0]}"
        for name, verdict in verdicts.items()
        if not verdict.mixed
    )


def _tie_notes(table: pd.DataFrame) -> list[str]:
    best, second = table.index[:2]
    if second not in tied(table):
        return []
    gap, se = -float(table["elpd_diff"].iloc[1]), float(table["diff_se"].iloc[1])
    reason = f"less than {TIE_NATS:g} nats" if gap < TIE_NATS else f"less than twice its standard error of {se:.1f}"
    return [f"{best} and {second} differ by {gap:.1f} nats, {reason}: the data do not tell them apart."]
