"""Whether what looks like a memory is one, or a force that nobody measured: a gust, a load, another machine.

The studied state is the integral of its rate, so that its own changes tell any force on it. A fast element of it is all
but the rate itself, and the columns of delays follow its changes too. Noise that hangs together in time does not take
that away: from one sample to the next a gust is new, and the state has moved with it. What remembers needs the last
samples least. So it is weighed once more without them, `BEHIND` samples behind and without delays, against noise that
hangs together in time, each of the two with the correlation that its own residuals have.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import expit

from bayes_greybox.discovery.evidence.evaluations import Evaluations, one_pattern
from bayes_greybox.discovery.suspects.channels import DELAY
from bayes_greybox.model.estimate.evidence import coefficients
from bayes_greybox.model.noise.in_time import in_time
from bayes_greybox.model.noise.noise_model import CORRELATED, NoiseModel

from .search import WINDOW
from .sets import MEMORY, Sets
from .worlds import World, log_noise

TURNS = 2
"""How often a correlation is found on the residuals of a fit under the one before."""


def told(found: Sequence[World], first: Sets) -> list[World]:
    """Worlds whose likeliest explanation remembers with the probability that it does.

    Args:
        found: Worlds, likeliest first.
        first: Sets under the noise that the rows come with.
    """
    least = found[0].total - WINDOW
    return [_told(world, first) if world.total > least else world for world in found]


def _told(world: World, first: Sets) -> World:
    best, columns = world.best, world.evaluations.statistics.columns
    if best.kind != MEMORY:
        return world
    memory = columns[best.memory[0]].memory
    assert memory is not None
    kinds = {i: columns[i].memory for i in world.evaluations.statistics.of_kind("memory")}
    if not any(other is not None and other.behind for other in kinds.values()):
        # Of samples along a path no rate was measured that they could tell.
        return world
    behind = tuple(i for i, other in kinds.items() if other == replace(memory, behind=True)) or best.memory
    core = tuple(i for i in best.columns if i not in first.always)
    own = tuple(i for i in best.columns if (suspect := columns[i].suspect) is None or suspect.kind != DELAY)
    gain = _in_time(world, (*own, *behind), first) - _in_time(world, own, first)
    # Places of columns are those of this world: each refines inner parameters, and has laws, of its own.
    own_sets = Sets(world.evaluations, first.most, first.in_time, first.always)
    prior = best.log_weight - best.log_evidence - own_sets.log_prior(core) - own_sets.log_beside(core)
    share = float(expit(gain + prior))
    explanations = tuple(
        replace(e, remembers=share) if e.memory == best.memory else e for e in world.explanations
    )  # fmt: skip
    return replace(world, explanations=explanations)


def _in_time(world: World, columns: Sequence[int], first: Sets) -> float:
    """Log evidence of columns under noise as it comes or, where that is likelier, that hangs together in time."""
    known, rows = world.evaluations, first.statistics.rows
    base = model = NoiseModel(rows.noise)
    target = rows.target / first.statistics.target_scale
    logs = []
    for _ in range(1 + TURNS):
        statistics = known.statistics.with_noise(model.noise)
        again = Evaluations(statistics, known.odds, known.evaluator)
        fitted = again.parametric([columns])[0]
        logs.append(fitted.all + log_noise(model, known.odds))
        if not base.noise.error.independent:
            # Filtered rows carry a known correlation.
            break
        mean, _ = coefficients(*one_pattern(fitted, int(np.argmax(fitted.by_pattern))))
        residual = target - statistics.at_rows(again.indices(columns)) @ mean
        suspicion = in_time(residual, base, rows.time, rows.run, statistics.noise, CORRELATED)
        if suspicion is None:
            break
        model = suspicion.model
    return max(logs)
