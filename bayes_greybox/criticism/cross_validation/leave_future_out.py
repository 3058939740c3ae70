"""Leave-future-out from one run: predictions of each step of time from the past."""

import numpy as np

from bayes_greybox.inference.posterior import Posterior

from .fold_densities import fold_parameters, past_densities
from .folds import Folds
from .loo import WEIGHTED_NOTE, Estimates, Loo, Refit, refitted_without, result, weighted
from .psis import count_draws, khat_threshold, log_mean, relative_efficiency, smoothed


def leave_future_out(
    posterior: Posterior, folds: Folds, at_most: int | None, refit: Refit | None, max_refits: int, progress: bool
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
    earlier steps use the last one. Other arguments are those of `cross_validate`.
    """
    posterior.require_rows("Leave-one-out and other folds are found")
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
            past = refitted_without(posterior, name, future, refit, progress, f"step {j} and later", warnings)
            parameters = fold_parameters(past, name, at_most)
            density = past_densities(posterior, name, parameters, first, members[: j + 1])
            elpd[j] = log_mean(density[:, j + 1 :] - density[:, j : j + 1])[0]
            learned, r_eff = j, relative_efficiency(past, name, len(parameters[1].sd))
            refitted[j] = True
            refits_left -= 1
    notes = [*folds.notes, *([WEIGHTED_NOTE] if weighted(posterior) else [])]
    total = sum(len(each.elpd) for each in estimates.values())
    exact = sum(int(each.refitted.sum()) for each in estimates.values())
    if exact:
        notes.append(f"{exact} of {total} steps had Pareto k above {threshold:.2f} and were refitted exactly.")
    bad = sum(int(np.sum(~(each.khat[~each.refitted] <= threshold))) for each in estimates.values())
    if bad:
        limit = "" if refit is None else f" after max_refits={max_refits} refits"
        notes.append(
            f"{bad} of {total} steps have Pareto k above {threshold:.2f}{limit}, and were not refitted: elpd and its "
            "standard error are not reliable."
        )
    return result(estimates, threshold, notes + warnings, folds)
