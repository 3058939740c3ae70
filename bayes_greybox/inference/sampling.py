"""A fit: one NUTS run on the hyperparameters and exact draws of the rest."""

import logging
import time
from collections.abc import Mapping

import jax
import numpy as np
from threadpoolctl import threadpool_limits

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.equation import Equation
from bayes_greybox.model.program import Program
from bayes_greybox.model.streams.statistics import RowStatistics, equations_of
from bayes_greybox.running.stages import stage, stages

from .kept.groups import data_table, tree_of, user_units
from .posterior import Made, Posterior
from .sampler.nuts import SAMPLING, Files
from .sampler.programs import Programs, programs_for
from .settings import Sampling

log = logging.getLogger(__name__)


def sample_posterior(
    model: Program,
    data: Trajectories,
    sampling: Sampling,
    *,
    progress: bool = True,
    equations: Mapping[str, Equation] | None = None,
    programs: Programs | None = None,
    what: str = SAMPLING,
    files: Files | None = None,
    whole: Mapping[str, RowStatistics] | None = None,
) -> Posterior:
    """Fit: assemble the designs, run NUTS on the hyperparameters, draw the rest exactly.

    Args:
        model: Model.
        data: Training data.
        sampling: Settings; the same seed gives the same posterior.
        progress: Whether to show a progress bar.
        equations: Frames and designs to use instead of `model.assemble(data)` (for refits that leave rows out).
        programs: Those of another fit of this model with these settings, to save compiling them again.
        what: What the bar says.
        files: Where chains are kept, and go on if they are there.
        whole: What all rows say, by equation, where the data are some of them.

    Raises:
        InputError: What `model.assemble` refuses; files that hold other chains.
    """
    with stages(progress):
        return _sampled(model, data, sampling, equations, programs, progress, what, files, whole)


def _sampled(
    model: Program,
    data: Trajectories,
    sampling: Sampling,
    equations: Mapping[str, Equation] | None,
    programs: Programs | None,
    progress: bool,
    what: str,
    files: Files | None,
    whole: Mapping[str, RowStatistics] | None,
) -> Posterior:
    if equations is None and whole is not None:
        equations = equations_of(model, data, whole)
    elif equations is None:
        with stage("Reading the rows"):
            equations = model.assemble(data)
    for name, each in equations.items():
        rows, frame = each.rows, each.frame
        log.debug(
            "%s: %d rows, %d terms, f of %s", name, rows.n_row, len(frame.dictionary), frame.variables or "nothing"
        )
    log.info("sampling %s: %d chains of %d + %d", ", ".join(equations), sampling.chains, sampling.tune, sampling.draws)
    start = time.perf_counter()
    designs = {name: equation.design for name, equation in equations.items()}
    programs = programs_for(model, designs, sampling) if programs is None else programs
    run_key, draw_key, prior_key = jax.random.split(jax.random.PRNGKey(sampling.seed), 3)

    # Threads inside BLAS fight those of the chains over the cores, for matrices too small to share.
    with threadpool_limits(1):
        chains = programs.chains.run(
            designs,
            draws=sampling.draws,
            chains=sampling.chains,
            key=run_key,
            progress=progress,
            what=what,
            files=files,
        )
        with stage("Drawing coefficients and f"):
            drawn = programs.conditional(designs, chains.samples, draw_key)
        with stage("Drawing from the prior"):
            prior = programs.prior(designs, prior_key)
            densities = programs.log_prior(designs, {**chains.samples, **drawn})
    log.info("sampled in %.1f s, %d divergences", time.perf_counter() - start, np.sum(chains.stats["diverging"]))
    groups = {
        "posterior": user_units({**chains.samples, **drawn}, equations),
        "sample_stats": chains.stats,
        "prior": user_units(prior, equations),
        "log_prior": densities,
        "observed_data": {model.sites[name].rate: equations[name].rows.shown for name in designs},
        "constant_data": data_table(data),
    }
    return Posterior(model, data, sampling, tree_of(groups, equations), Made(model, data, equations, programs), whole)
