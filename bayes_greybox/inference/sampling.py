"""A fit: one NUTS run on the hyperparameters and exact draws of everything else."""

import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass

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
from .sampler.nuts import SAMPLING_LABEL, Files
from .sampler.programs import Programs, programs_for
from .settings import Sampling

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RunOptions:
    """Choices that change no draw: text of the progress bar, files that keep the chains, programs of a like fit."""

    label: str = SAMPLING_LABEL
    files: Files | None = None
    programs: Programs | None = None


def sample_posterior(
    model: Program, data: Trajectories, sampling: Sampling, *, progress: bool = True,
    equations: Mapping[str, Equation] | None = None, whole: Mapping[str, RowStatistics] | None = None,
    options: RunOptions | None = None,
) -> Posterior:  # fmt: skip
    """Assemble the designs, run NUTS on the hyperparameters, and draw the rest exactly; the same seed, the same draws.

    Refits that leave rows out give `equations` in place of those assembled from the data; of a stream, of which the
    data are a sample, `whole` has the statistics of all rows. InputError is raised if the model cannot be assembled
    from the data, or the files keep other chains.
    """
    options = options or RunOptions()
    with stages(progress):
        if equations is None:
            with stage("Reading the rows"):
                equations = model.assemble(data) if whole is None else equations_of(model, data, whole)
        for name, each in equations.items():
            n_term, variables = len(each.frame.dictionary), each.frame.variables or "nothing"
            log.debug("%s: %d rows, %d terms, f of %s", name, each.rows.n_row, n_term, variables)
        log.info(
            "sampling %s: %d chains of %d + %d", ", ".join(equations), sampling.chains, sampling.tune, sampling.draws
        )
        start, designs = time.perf_counter(), {name: equation.design for name, equation in equations.items()}
        programs = options.programs or programs_for(model, designs, sampling)
        run_key, draw_key, prior_key = jax.random.split(jax.random.PRNGKey(sampling.seed), 3)
        # Threads inside BLAS fight those of the chains over the cores, for matrices too small to share.
        with threadpool_limits(1):
            chains = programs.chains.run(
                designs, draws=sampling.draws, chains=sampling.chains, key=run_key, progress=progress,
                label=options.label, files=options.files,
            )  # fmt: skip
            with stage("Drawing coefficients and f"):
                drawn = {**chains.samples, **programs.conditional(designs, chains.samples, draw_key)}
            with stage("Drawing from the prior"):
                prior = programs.prior(designs, prior_key)
                densities = programs.log_prior(designs, drawn)
    log.info("sampled in %.1f s, %d divergences", time.perf_counter() - start, np.sum(chains.stats["diverging"]))
    groups = {
        "posterior": user_units(drawn, equations),
        "sample_stats": chains.stats,
        "prior": user_units(prior, equations),
        "log_prior": densities,
        "observed_data": {model.sites[name].rate: equations[name].rows.shown for name in designs},
        "constant_data": data_table(data),
    }
    return Posterior(model, data, sampling, tree_of(groups, equations), Made(model, data, equations, programs), whole)
