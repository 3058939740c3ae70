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
from .folds import FUTURE_START, check_scheme, make_folds
from .loo import Loo, weighted

TIE_NATS = 4.0
"""Differences smaller than this are inconclusive, whatever their standard error (Sivula et al. 2020)."""


def compare(
    fits: Mapping[str, Posterior], scheme: str = "loo", *, block: int | None = None, start: float = FUTURE_START,
    at_most: int | None = None, max_refits: int = 10, progress: bool = True,
) -> pd.DataFrame:  # fmt: skip
    """Compare models by cross-validation, from one run each.

    Args:
        fits: Fits by name, all to the same data.
        scheme: "loo": leave out one observation at a time; "block": contiguous rows; "trajectory": whole runs;
            "future": predict each step of time from all before it.
        block: Rows of a block, or time stamps of a step into the future, the same for all models. None: the longest
            that any of them needs, by the autocorrelation of the residual of its dictionary.
        start: Share of the time stamps before the first prediction, for "future".
        at_most: Thin each model's draws evenly to this many; None: all.
        max_refits: Most exact refits of flagged folds for each model, as for `cross_validate`.
        progress: If true, refits of flagged folds show their progress.

    Returns:
        A table indexed by name, best first: elpd and se (nats), elpd_diff (elpd less that of the best model,
        ≤ 0) and diff_se (from the pointwise differences), p_eff, weight (stacking), worst_k (largest Pareto k
        among folds that were not refitted) and refits. `table.attrs` has "notes" with warnings, "scheme", "block",
        "folds" (in words) and "threshold" (of Pareto k).

    Raises:
        InputError: Fewer than two models, a scheme that is unknown or does not suit the data, fits to different data or
            different equations, or fits of which only some weight rows by their residuals.
    """
    check_scheme(scheme, block, start)
    if len(fits) < 2:
        raise InputError(f"compare needs at least two models, not {len(fits)}: pass {{'name': fit, 'other': fit}}.")
    _require_same_data(fits)
    _require_weighted_alike(fits)
    chosen = ()
    if scheme in ("block", "future") and block is None:
        longest = max((make_folds(fit, scheme, None, start) for fit in fits.values()), key=lambda each: each.block or 0)
        block, chosen = longest.block, longest.notes
    order, results = tuple(next(iter(fits.values())).equations), {}
    options = {"block": block, "start": start, "at_most": at_most, "max_refits": max_refits, "progress": progress}
    for name, fit in fits.items():
        results[name] = _in_order(cross_validate(fit, scheme, **options), tuple(fit.equations), order)
    verdicts = {name: convergence(fit) for name, fit in fits.items()}
    unmixed = [
        f"{name} has not converged, so its elpd is not reliable: {verdict.reasons[0]}"
        for name, verdict in verdicts.items()
        if not verdict.mixed
    ]
    return comparison_table(results, (*chosen, *unmixed))


def comparison_table(results: Mapping[str, Loo], notes: tuple[str, ...] = ()) -> pd.DataFrame:
    """Return the table of `compare` from cross-validation results over the same folds in the same order."""
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
    first, threshold = next(iter(results.values())), min(result.threshold for result in results.values())
    table.attrs |= {"scheme": first.scheme, "block": first.block, "folds": first.words, "threshold": threshold}
    return table


def tied(table: pd.DataFrame) -> list[str]:
    """Return the models in a table of `compare` that the data do not tell apart from the best.

    They are behind by less than `TIE_NATS`, or by less than twice the standard error of the difference.
    """
    gap, se = -table["elpd_diff"].iloc[1:], table["diff_se"].iloc[1:]
    return [str(name) for name in gap.index[(gap < TIE_NATS) | (gap < 2 * se)]]


def unreliable(table: pd.DataFrame) -> list[str]:
    """Return the models in a table of `compare` whose Pareto k is too large for importance sampling."""
    return [str(name) for name in table.index[~(table["worst_k"] <= table.attrs["threshold"])]]


def stacking_weights(pointwise: Float[np.ndarray, "n_obs n_model"]) -> Float[np.ndarray, " n_model"]:
    """Return the weights of the mixture that predicts best: max_w Σ_i log Σ_k w_k exp(elpd_ik) over the simplex.

    Yao, Vehtari, Simpson & Gelman 2018, Eq. 6. The problem is concave; its gradient is Σ_i p_ik / Σ_j w_j p_ij.
    `pointwise` are elpd of each observation under each model, in nats.
    """
    # The scale of each row is free; with the largest at one nothing overflows.
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


def _require_weighted_alike(fits: Mapping[str, Posterior]) -> None:
    names: dict[bool, str] = {}
    for name, fit in fits.items():
        names.setdefault(weighted(fit), name)
    if len(names) > 1:
        raise InputError(
            f"compare: {names[True]!r} has Noise(tails=...), which weighs each row by its own residual and so predicts "
            f"what it has seen, and {names[False]!r} has not: fit all with the same Noise(tails=4.0), say, or all "
            "without, and ask fit.checks() which noise the data want."
        )


def _require_same_data(fits: Mapping[str, Posterior]) -> None:
    (first, reference), *others = fits.items()
    remedy = "fit all models to the same data."
    for name, fit in others:
        pair = f"compare: {first!r} and {name!r} were fitted to different data"
        if set(fit.model.equations) != set(reference.model.equations):
            raise InputError(
                f"compare: {first!r} learns {', '.join(reference.model.equations)} but {name!r} learns "
                f"{', '.join(fit.model.equations)}; compare models of the same equations."
            )
        if fit.data.n_obs != reference.data.n_obs:
            raise InputError(f"{pair}: {reference.data.n_obs} rows against {fit.data.n_obs}; {remedy}")
        # The data of a stream are a sample, which may be the same for different streams.
        if fit.n_obs != reference.n_obs:
            raise InputError(
                f"{pair}: {reference.n_obs:,} rows, of which some are looked at, against {fit.n_obs:,}; {remedy}"
            )
        if fit.data.run_lengths != reference.data.run_lengths:
            raise InputError(f"{pair}: the rows are divided into trajectories differently; {remedy}")
        columns = {"time": (reference.data.time, fit.data.time)}
        for equation, entry in reference.equations.items():
            one, other = entry.rows, fit.equations[equation].rows
            if one.n_row != other.n_row:
                raise InputError(f"{pair}: {one.n_row} rows of {equation!r} against {other.n_row}; {remedy}")
            kind = "the output" if one.output else "the derivative of"
            columns[f"{kind} {equation!r}"] = (one.shown, other.shown)
        for what, (one, other) in columns.items():
            if not np.allclose(one, other, rtol=1e-9, atol=1e-9 * np.abs(one).max()):
                if what != "time" and _same_samples(reference.data.samples, fit.data.samples):
                    raise InputError(
                        f"compare: the rows of {first!r} and {name!r} mix the same samples in different ways, each as "
                        "the model does that they are near, so that their densities are not of the same numbers: fit "
                        "both with rows=bg.TrajectoryRows(), whose rows are the samples themselves."
                    )
                worst = float(np.abs(one - other).max())
                raise InputError(f"{pair}: {what} differs by up to {worst:.3g}; {remedy}")
        for equation, entry in reference.equations.items():
            if fit.equations[equation].rows.n_white != entry.rows.n_white:
                raise InputError(
                    f"{pair}: the derivatives of {equation!r} come from different differentiators; {remedy}"
                )


def _same_samples(one: Trajectories | None, other: Trajectories | None) -> bool:
    """Return True if both rows come from samples, and from the same."""
    if one is None or other is None or one.state_names != other.state_names:
        return False
    return np.array_equal(one.matrix(one.state_names), other.matrix(other.state_names))


def _in_order(result: Loo, equations: Sequence[str], order: Sequence[str]) -> Loo:
    """Return a result with its equations in another order."""
    places = [equations.index(name) for name in order]
    index = np.concatenate([np.flatnonzero(result.equation == place) for place in places])
    folds = {name: getattr(result, name)[index] for name in ("pointwise", "khat", "refitted", "row")}
    r_eff = tuple(result.r_eff[place] for place in places)
    return replace(result, **folds, equation=np.argsort(places)[result.equation[index]], r_eff=r_eff)


def _model_notes(results: Mapping[str, Loo]) -> list[str]:
    """Return the notes of each model under its name, and notes of all models once."""
    shared = [note for note in next(iter(results.values())).notes if all(note in r.notes for r in results.values())]
    further = [f"{name}: {note}" for name, r in results.items() for note in r.notes if note not in shared]
    return [*(f"all models: {note}" for note in shared), *further] if len(results) > 1 else further


def _tie_notes(table: pd.DataFrame) -> list[str]:
    best, second = table.index[:2]
    if second not in tied(table):
        return []
    gap, se = -float(table["elpd_diff"].iloc[1]), float(table["diff_se"].iloc[1])
    reason = f"less than {TIE_NATS:g} nats" if gap < TIE_NATS else f"less than twice its standard error of {se:.1f}"
    return [f"{best} and {second} differ by {gap:.1f} nats, {reason}: the data do not tell them apart."]
