"""The data as the study uses them: free of noise on their samples, delays undone, suspects taken along the whole rate.

A delay's column is that of the rate as modelled, with what is missing in it. So suspects and effects are found in
turns: effects with the suspects as they are, the suspects' columns anew with the effects found, delays undone in the
data, until neither changes.
"""

from collections.abc import Callable, Sequence
from itertools import chain

import numpy as np
from jaxtyping import Bool, Int

from bayes_greybox.data.noise.protocol import RowNoise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.evidence.evaluations import Evaluations, one_pattern
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.discovery.evidence.of_equation import sufficient_statistics
from bayes_greybox.discovery.evidence.sufficient_statistics import SufficientStatistics
from bayes_greybox.discovery.evidence.with_discrepancy import Evaluator
from bayes_greybox.discovery.suspects.channels import (
    DELAY,
    ChannelSuspect,
    Rate,
    suspect_columns,
    undone,
)
from bayes_greybox.discovery.suspects.drift import drift_columns
from bayes_greybox.discovery.suspects.late import late_states
from bayes_greybox.discovery.suspects.memory import memory_columns
from bayes_greybox.discovery.suspects.samples import Smoother, known_rates
from bayes_greybox.model.estimate.evidence import coefficients
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.terms import Term

from .aligned import Aligned
from .sensor_rows import at_end, beyond, earlier, mended, usable
from .sets import Sets

TURNS = 8
"""How often suspects and effects are found in turns, at most."""

MOVED = 0.02
"""Change of a delay, in sampling steps, below which it is settled."""


FURTHEST, FURTHEST_DELAY = 3.0, 2.0
"""Largest size of a suspect, and of a delay, in prior standard deviations, that is still an error of a sensor."""

LATE = 0.9
"""Probability that some channel is late from which on its delay is undone, and in every set: till then it is a suspect
among others, since a wrong coefficient may look like it."""


def align(
    model: Program,
    train: Trajectories,
    equation: str,
    effects: Sequence[BoundEffect],
    odds: Odds,
    most: int,
    report: Callable[[str], None] = lambda text: None,
    under: tuple[RowNoise, Bool[np.ndarray, " n_obs"]] | None = None,
    smooth: Smoother | None = None,
) -> Aligned:
    """Find delays and what is missing in turns.

    Args:
        model: The model before.
        train: Measurements as they came.
        equation: The studied state.
        effects: Effects bound to columns.
        odds: Prior odds.
        most: Largest number of effects.
        report: Told in words what is being done.
        under: Noise of the rows that delays are found under, and the rows that it is of; that of the rows as they come
            by default.
        smooth: Frees states of the noise on their samples; found from the data by default.
    """
    smooth = smooth or Smoother(train, known_rates(model.simulator(train), train))
    bare_rate = modelled_rate(model, train, equation, ())
    clipped, (better, slips) = at_end(train, equation), mended(train, equation, bare_rate)
    measured = smooth(better)
    late = late_states(measured, model.simulator(train), {name: noise.left for name, noise in smooth.noise.items()})
    measured = earlier(measured, late)
    out = (*clipped.values(), *slips.values(), *beyond(train, late))
    delays: dict[str, float] = {}
    probability: dict[str, float] = {}
    added: tuple[tuple[Term, float], ...] = ()
    # All rows, for what needs neighbours, and those that are weighed.
    seen = np.ones(train.n_obs, bool) if under is None else under[1]
    whole, used = measured, seen & usable(measured, equation, delays, out)
    data = whole.keep(used)
    statistics = sufficient_statistics(model, data, equation, effects)
    evaluator = Evaluator(statistics.prior, statistics.kernel, np.asarray(statistics.basis.frequency))
    # Samples of a rate tell a state's delay better than the rate of that one does.
    before, moved, too_far = None, False, {ChannelSuspect(DELAY, name, 0.0).key for name in late}
    rate, turn = modelled_rate(model, whole, equation, added), 0
    own = statistics.rows.noise
    while True:
        if turn:
            report("taking suspects along the rate with what was found")
        bare = statistics if not turn else _anew(model, data, equation, statistics, moved)
        # Statistics that stay the same are under the noise of the turn before.
        own = bare.rows.noise if moved else own
        columns = [(suspect, column[used]) for suspect, column in suspect_columns(whole, equation, rate)]
        known = {c[0].key for c in columns if c[0].kind == DELAY and c[0].channel in delays}
        bare.suspect([c for c in columns if c[0].key not in too_far], known)
        if moved or not turn:
            # What was there at rows that are out is remembered too.
            elements = chain(memory_columns(whole, equation), drift_columns(whole))
            bare.remember((memory, table[used]) for memory, table in elements)
        given = bare if under is None else bare.with_noise(_at(under[0], measured.run, seen, used))
        evaluations = Evaluations(given, odds, evaluator)
        always = tuple(i for i in _delays(given) if (s := given.columns[i].suspect) is not None and s.channel in delays)
        sets = Sets(evaluations, most, always=always)
        core = sets.likeliest()
        found = tuple(sorted(_label(evaluations, i) for i in core))
        fitted = sets.parametric((*always, *core))
        mean = coefficients(*one_pattern(fitted, int(np.argmax(fitted.by_pattern))))[0]
        indices = evaluations.indices((*always, *core))
        moved, later = False, dict(delays)
        late_ones = [i for i in _delays(given) if i not in always]
        p_late = sets.probability(late_ones) if set(core) & set(late_ones) else 0.0
        for index, value in zip(indices, mean, strict=True):
            suspect = given.columns[index].suspect
            if suspect is None:
                continue
            by = float(value) * given.target_scale / given.columns[index].scale
            so_far = later.get(suspect.channel, 0.0) if suspect.kind == DELAY else 0.0
            if abs(so_far + by) > (FURTHEST_DELAY if suspect.kind == DELAY else FURTHEST) * suspect.sd:
                # No sensor is so far off: it stands in for a gap, which is left to stand.
                too_far |= {suspect.key, *(key for key, stays in given.twins.items() if stays == suspect.key)}
                if suspect.kind == DELAY:
                    later.pop(suspect.channel, None)
                moved = True
                continue
            # What smoothing leaves of the noise on samples looks like a delay: it stays a suspect among others.
            if suspect.kind != DELAY or smooth.noise or (index not in always and p_late < LATE):
                continue
            later[suspect.channel] = so_far + by
            if index not in always:
                # Later it is in every set, so its probability is that of the turns before.
                probability[suspect.channel] = max(probability.get(suspect.channel, 0.0), p_late)
            moved |= abs(by) > MOVED * suspect.step
        statistics = given
        turn += 1
        if (not moved and found == before) or turn == TURNS:
            # What is left of a delay is in its column, on the data as they are.
            break
        before = found
        if moved:
            # Else the statistics stay those of the data as they are.
            delays, whole = later, undone(measured, equation, later)
            used = seen & usable(measured, equation, delays, out)
            data = whole.keep(used)
        added = tuple(
            (term, float(b) * given.target_scale / given.columns[i].scale)
            for i, b in zip(indices, mean, strict=True)
            if (term := given.columns[i].term) is not None
        )
        rate = modelled_rate(model, whole, equation, added)
    if under is not None:
        # Found under one noise, weighed under all; columns keep their places.
        evaluations = Evaluations(given.with_noise(own), odds, evaluator)
        sets = Sets(evaluations, most, always=always)
    return Aligned(
        data, sets, delays, probability, sample_noise=smooth.noise, late=late, clipped=clipped, misread=slips,
        rate=rate, bare=bare_rate, used=used, smooth=smooth,
    )  # fmt: skip


def modelled_rate(model: Program, data: Trajectories, equation: str, added: Sequence[tuple[Term, float]]) -> Rate:
    """Simulation and what was found, on any data of the same columns.

    Args:
        model: The model before.
        data: Data with these columns.
        equation: The studied state.
        added: Terms and their coefficients.
    """
    simulation = model.simulator(data)

    def rate(data: Trajectories) -> np.ndarray:
        total = simulation.on(data, equation)
        for term, coefficient in added:
            total = total + coefficient * np.asarray(term.evaluate(data.columns))
        return total

    return rate


def _anew(
    model: Program,
    data: Trajectories,
    equation: str,
    before: SufficientStatistics,
    moved: bool,
) -> SufficientStatistics:
    """Statistics without suspects, on data whose delays are undone, with the terms and inner parameters so far."""
    if not moved:
        before.drop("suspect")
        return before
    fresh = sufficient_statistics(model, data, equation, [])
    effects = [
        (c.term, {"effect": c.effect, "inner": c.inner, "log_weight": c.log_weight, "drawn": c.drawn})
        for c in before.columns
        if c.kind == "effect" and c.term is not None
    ]
    fresh.add("effect", effects)
    fresh.left_out = {**before.left_out, **fresh.left_out}
    return fresh


def _at(
    noise: RowNoise, run: Int[np.ndarray, " n_obs"], seen: Bool[np.ndarray, " n_obs"], used: Bool[np.ndarray, " n_obs"]
) -> RowNoise:
    """Noise of the rows in use, of that of the rows that were seen: what is missing is missing at ends of runs."""
    if np.array_equal(seen, used):
        return noise
    bounds = []
    for r in dict.fromkeys(run[seen].tolist()):
        inside = np.flatnonzero(used[seen & (run == r)])
        bounds.append((int(inside[0]), int(inside[-1]) + 1) if len(inside) else (0, 0))
    return noise.restrict(bounds)


def _delays(statistics: SufficientStatistics) -> list[int]:
    """Columns of delays."""
    every = [(i, statistics.columns[i].suspect) for i in statistics.of_kind("suspect")]
    return [i for i, suspect in every if suspect is not None and suspect.kind == DELAY]


def _label(evaluations: Evaluations, index: int) -> str:
    suspect = evaluations.statistics.columns[index].suspect
    return suspect.key if suspect is not None else evaluations.binding(index)
