"""Cross-validation of one fit: closed forms given η, Pareto-smoothed importance sampling over η, exact refits."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from bayes_greybox.criticism.convergence import convergence
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.sampling import RunOptions, sample_posterior

from .fold_densities import fold_densities, fold_parameters, past_densities
from .folds import FUTURE_START, Folds, check_scheme, make_folds
from .loo import Estimates, Loo, joined
from .psis import count_draws, khat_threshold, log_mean, relative_efficiency, smoothed
from .row_densities import kept_densities, row_densities

Refit = Callable[[Posterior, str, list[int]], Posterior]
"""(posterior, equation, observations) -> posterior of that equation without these observations."""


def refit_without(posterior: Posterior, equation: str, rows: Sequence[int], progress: bool = False) -> Posterior:
    """Run NUTS again without some observations of one equation; all that was fixed before sampling stays as it was.

    Observations are rows of the data, or whitened coefficients if R is singular.
    """
    without = {equation: posterior.equations[equation].without(rows)}
    options = RunOptions("Fitting without what is left out", programs=posterior.programs)
    return sample_posterior(
        posterior.model, posterior.data, posterior.sampling, progress=progress, equations=without, options=options
    )


def cross_validate(
    posterior: Posterior, scheme: str = "loo", *, block: int | None = None, start: float = FUTURE_START,
    at_most: int | None = None, refit: Refit | None = refit_without, max_refits: int = 10, progress: bool = True,
) -> Loo:  # fmt: skip
    """Estimate the expected log predictive density of rows that are left out, from one run.

    Args:
        posterior: Fitted model.
        scheme: "loo": one row at a time. "block": contiguous rows, for time series, whose neighbours predict a row.
            "trajectory": whole runs. "future": each step of time from all before it.
        block: Rows of a block, or time stamps of a step into the future; None: chosen from the autocorrelation of
            the residual of the dictionary, and stated in the result's notes.
        start: Share of the time stamps before the first prediction, for "future".
        at_most: Thin the draws evenly to this many; None: all.
        refit: Function that fits again without folds whose Pareto k̂ is too large; None: no refits.
        max_refits: Most refits. If more folds need one, "future" makes this many, the other schemes none.
        progress: If true, refits show their progress.

    Returns:
        The result; its notes have choices and warnings.

    Raises:
        InputError: The scheme or block does not suit the data, or there are fewer than 25 draws.
    """
    check_scheme(scheme, block, start)
    folds = None if scheme == "loo" else make_folds(posterior, scheme, block, start)
    posterior.require_rows("Leave-one-out and other folds are found")
    if refit is refit_without:
        refit = partial(refit_without, progress=progress)
    if folds is not None and scheme == "future":
        return _leave_future_out(posterior, folds, at_most, refit, max_refits)
    return _leave_folds_out(posterior, folds, at_most, refit, max_refits)


def _leave_folds_out(
    posterior: Posterior, folds: Folds | None, at_most: int | None, refit: Refit | None, max_refits: int
) -> Loo:
    """Leave folds out, single observations if `folds` is None, by importance sampling over the draws of one run.

    elpd_F = log Σ_s w_Fs p(y_F | y₋F, η_s), with w_Fs ∝ 1/p(y_F | y₋F, η_s) Pareto-smoothed (Vehtari et al. 2024;
    Bürkner, Gabry & Vehtari 2021, section 2.3, for models whose observations are not independent given η).
    """
    n_draw = count_draws(posterior, at_most)

    def blocks(run: Posterior, name: str, index: np.ndarray | None = None) -> Iterator[np.ndarray]:
        stored = kept_densities(run, name) if folds is None and index is None and at_most is None else None
        if stored is not None:
            yield stored
        elif folds is None:
            yield from row_densities(posterior, name, run.draws(name, at_most), index)
        else:
            yield from fold_densities(posterior, name, fold_parameters(run, name, at_most), folds.members[name], index)

    estimates = {}
    for name in posterior.equations:
        r_eff = relative_efficiency(posterior, name, n_draw)
        parts = [smoothed(part, -part, r_eff) for part in blocks(posterior, name)]
        elpd, mean, khat = map(np.concatenate, zip(*parts, strict=True))
        estimates[name] = Estimates(elpd, mean, khat, np.zeros(len(elpd), bool), r_eff)
    threshold = khat_threshold(n_draw)
    flagged = [(name, int(i)) for name, each in estimates.items() for i in np.flatnonzero(~(each.khat <= threshold))]
    what = "observations" if folds is None else {"block": "blocks", "trajectory": "trajectories"}[folds.scheme]
    total = sum(len(each.elpd) for each in estimates.values())
    share = f"{len(flagged)} of {total} {what} have Pareto k above {threshold:.2f}"
    notes: list[str] = []
    if flagged and refit is not None and len(flagged) <= max_refits:
        notes.append(f"{share}; their values come from exact refits.")
        for name, i in flagged:
            rows = [i] if folds is None else folds.members[name][i].tolist()
            about = f"observation {i}" if folds is None else f"{folds.scheme} {i}"
            without = _refitted(posterior, name, rows, refit, about, notes)
            (values,) = blocks(without, name, np.array([i]))
            estimates[name].elpd[i] = log_mean(values)[0]
            estimates[name].refitted[i] = True
    elif flagged:
        limit = "" if refit is None else f", more than max_refits={max_refits}"
        notes.append(f"{share}{limit}, and were not refitted: elpd and its standard error are not reliable.")
    return joined(posterior, estimates, threshold, notes, folds)


def _leave_future_out(
    posterior: Posterior, folds: Folds, at_most: int | None, refit: Refit | None, max_refits: int
) -> Loo:
    """Leave the future out: elpd = Σ_j log p(y_j | y_<j) over consecutive steps j of the folds.

    These are the M-step-ahead predictions of Bürkner, Gabry & Vehtari 2020 (Approximate leave-future-out
    cross-validation for Bayesian time series models), made every M time stamps, so that each row is predicted
    once. By the chain rule their sum is log p(y_future | y_past) whatever M is. Given η they are differences of
    log p(y_≤j | η); over η,

        log p(y_j | y_<j) = log Σ_s w_s p(y_j | y_<j, η_s),   w_s ∝ p(y_<j | η_s)/p(y | η_s), smoothed.

    The steps go backwards from the end (the backward mode of that paper). If k̂ is above the threshold the model is
    fitted again to the past of that step, which makes this step exact, and earlier ones use that run. Choices made
    before sampling (scaling, measure, features) are those of all the data. After the last refit over all equations,
    earlier steps use the last one.
    """
    n_draw = count_draws(posterior, at_most)
    threshold = khat_threshold(n_draw)
    estimates: dict[str, Estimates] = {}
    warnings: list[str] = []
    refits_left = 0 if refit is None else max_refits
    for name in posterior.equations:
        members, first = folds.members[name], folds.past[name]
        density = past_densities(posterior, name, fold_parameters(posterior, name, at_most), first, members)
        n_fold, r_eff = len(members), relative_efficiency(posterior, name, n_draw)
        elpd, khat, refitted = np.zeros(n_fold), np.zeros(n_fold), np.zeros(n_fold, bool)
        estimates[name] = Estimates(elpd, log_mean(np.diff(density, axis=1)), khat, refitted, r_eff)
        # The run in use has learned from the first `learned` folds.
        learned = n_fold
        for j in reversed(range(n_fold)):
            value, ratio = density[:, j + 1] - density[:, j], density[:, j] - density[:, learned]
            (elpd[j],), _, (khat[j],) = smoothed(value[:, None], ratio[:, None], r_eff)
            if khat[j] <= threshold or not refits_left or refit is None:
                continue
            future = np.sort(np.concatenate(members[j:])).tolist()
            past = _refitted(posterior, name, future, refit, f"step {j} and later", warnings)
            parameters = fold_parameters(past, name, at_most)
            density = past_densities(posterior, name, parameters, first, members[: j + 1])
            elpd[j] = log_mean(density[:, j + 1 :] - density[:, j : j + 1])[0]
            learned, r_eff = j, relative_efficiency(past, name, len(parameters[1].sd))
            refitted[j] = True
            refits_left -= 1
    result, notes = joined(posterior, estimates, threshold, (), folds), []
    total = len(result.pointwise)
    if result.refits:
        notes.append(f"{result.refits} of {total} steps had Pareto k above {threshold:.2f} and were refitted exactly.")
    if result.n_bad:
        limit = "" if refit is None else f" after max_refits={max_refits} refits"
        notes.append(
            f"{result.n_bad} of {total} steps have Pareto k above {threshold:.2f}{limit}, and were not refitted: elpd "
            "and its standard error are not reliable."
        )
    return replace(result, notes=(*result.notes, *notes, *warnings))


def _refitted(
    posterior: Posterior, equation: str, rows: list[int], refit: Refit, about: str, notes: list[str]
) -> Posterior:
    """Fit again without some observations, and add a note if that run has not converged."""
    without = refit(posterior, equation, rows)
    verdict = convergence(without)
    if not verdict.mixed:
        notes.append(f"The refit without {about} of {equation!r} has not converged: {verdict.reasons[0]}")
    return without
