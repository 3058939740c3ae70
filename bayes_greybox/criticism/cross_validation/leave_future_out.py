"""Leave-future-out from one run: how well the past predicts what came after."""

import numpy as np

from bayes_greybox.inference.posterior import Posterior

from .fold_densities import fold_parameters, past_densities
from .folds import Folds
from .loo import Loo, Refit, refitted_without, result
from .psis import count_draws, khat_threshold, log_mean, relative_efficiency, smoothed
from .refits import refit_without
from .weighted_rows import NOTE, weighted


def leave_future_out(
    posterior: Posterior,
    folds: Folds,
    at_most: int | None = None,
    *,
    refit: Refit | None = refit_without,
    max_refits: int = 10,
    progress: bool = True,
) -> Loo:
    """Leave-future-out: elpd = Σ_j log p(y_j | y_<j) over consecutive steps j of the folds.

    These are the M-step-ahead predictions of Bürkner, Gabry & Vehtari 2020 (Approximate leave-future-out
    cross-validation for Bayesian time series models), made every M time stamps, so that each row is predicted
    once. By the chain rule their sum is log p(y_future | y_past) whatever M is. Given η they are differences of
    log p(y_≤j | η); over η,

        log p(y_j | y_<j) = log Σ_s w_s p(y_j | y_<j, η_s),   w_s ∝ p(y_<j | η_s)/p(y | η_s), smoothed.

    The steps are taken backwards from the end (the backward mode of that paper). Where k̂ is above the threshold the
    model is fitted again to the past of that step, which makes this one exact, and the earlier ones rely on that
    run. What was fixed before sampling (scaling, measure, features) is that of all the data.

    Args:
        posterior: Fitted model.
        folds: From `make_folds(posterior, "future")`.
        at_most: Thin the draws evenly to this many; None: all.
        refit: How to fit again without the future; None: not at all.
        max_refits: After so many refits, counted over all equations, the earlier steps rely on the last.
        progress: Whether refits show their progress.

    Raises:
        InputError: Fewer than 25 draws.
    """
    posterior.require_rows("Leave-one-out and other folds are found")
    n_draw = count_draws(posterior, at_most)
    threshold = khat_threshold(n_draw)
    names = tuple(posterior.equations)
    efficiency = {name: relative_efficiency(posterior, name, n_draw) for name in names}
    n_fold = {name: len(folds.members[name]) for name in names}
    elpd, spread, khat = ({name: np.zeros(n_fold[name]) for name in names} for _ in range(3))
    refitted = {name: np.zeros(n_fold[name], bool) for name in names}
    warnings: list[str] = []
    left = 0 if refit is None else max_refits
    for name in names:
        members, first = folds.members[name], folds.past[name]
        density = past_densities(posterior, name, fold_parameters(posterior, name, at_most), first, members)
        spread[name] = log_mean(np.diff(density, axis=1))
        # The run in use knows the first `known` folds, and this is its efficiency.
        known, r_eff = n_fold[name], efficiency[name]
        for j in reversed(range(n_fold[name])):
            value, ratio = density[:, j + 1] - density[:, j], density[:, j] - density[:, known]
            (elpd[name][j],), _, (khat[name][j],) = smoothed(value[:, None], ratio[:, None], r_eff)
            if khat[name][j] <= threshold or not left or refit is None:
                continue
            future = np.sort(np.concatenate(members[j:])).tolist()
            past = refitted_without(posterior, name, future, refit, progress, f"step {j} and later", warnings)
            parameters = fold_parameters(past, name, at_most)
            density = past_densities(posterior, name, parameters, first, members[: j + 1])
            elpd[name][j] = log_mean(density[:, j + 1 :] - density[:, j : j + 1])[0]
            known, r_eff = j, relative_efficiency(past, name, len(parameters[1].sd))
            refitted[name][j] = True
            left -= 1
    notes = [*folds.notes, *([NOTE] if weighted(posterior) else [])]
    total, exact = sum(n_fold.values()), sum(int(a.sum()) for a in refitted.values())
    if exact:
        notes.append(f"{exact} of {total} steps had Pareto k above {threshold:.2f} and were refitted exactly.")
    bad = sum(int(np.sum(~(khat[name][~refitted[name]] <= threshold))) for name in names)
    if bad:
        limit = "" if refit is None else f" after max_refits={max_refits} refits"
        notes.append(
            f"{bad} of {total} steps have Pareto k above {threshold:.2f}{limit}, and were not refitted: elpd and its "
            "standard error are not reliable."
        )
    return result(elpd, spread, khat, refitted, threshold, efficiency, notes + warnings, folds)
