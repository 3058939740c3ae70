"""Effects that a fault of the only sensor does as well: a lag of the actuator and one of the sensor.

A first-order lag of the input, G(s) u/(1 + τs), and one of the sensor that shows what it does, G(s)/(1 + τs) u, are one
transfer function: samples of a linear machine cannot tell them apart, and of another machine they may. So the lag of
the sensor is followed along a path of its own, the machine's with one state more, and the two likelihoods say which.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.evidence.columns import Column
from bayes_greybox.model.estimate.near import near_estimate
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows
from bayes_greybox.physics.simulation.reading import readable
from bayes_greybox.physics.terms import Term

from .finding import Finding
from .weighed import Mirror

NEARBY = 0.02
"""Relative change of the actuator's time at which its likelihood is looked at, too."""


def mirrors(
    model: Program, train: Trajectories, equation: str, finding: Finding, known: Collection[str],
    say: Callable[[str], None],
) -> dict[str, Mirror]:  # fmt: skip
    """For each lag of an input among the effects of an answer, the same of the only sensor; by the effect's binding.

    Nothing where rates were measured, and where several sensors would have to lag alike. The prior odds stand
    (`Odds.slow_sensor`) where the two likelihoods would not be the answer's: beside errors of sensors, where noise is
    not white, and where another effect of the answer remembers too.

    Args:
        model: The model before.
        train: Samples.
        equation: The learned state.
        finding: The answer.
        known: Bindings that were looked at before, and are left out.
        say: Told in words what is being done.
    """
    samples = train.samples or train
    if model.rows.rates_measured or len(samples.state_names) != 1:
        return {}
    if not model.simulation or not readable(model.simulation):
        return {}
    statistics = finding.world.evaluations.statistics
    columns = [statistics.columns[place.index] for place in finding.places]
    corrections = [statistics.columns[i].formula for i in statistics.of_kind("correction")]
    prior = finding.world.evaluations.odds.slow_sensor
    white = not finding.explanation.suspects and not finding.world.model.names
    step = float(np.median(np.diff(samples.time)[np.diff(samples.run) == 0]))
    found = {}
    for column in columns:
        others = [other.formula for other in columns if other is not column]
        if _input_of(column) and len(column.inner) == 1 and column.called not in known:
            say("weighing a lag of the sensor beside that of the actuator")
            # Of two inputs that lag no sensor does what both do.
            comparable = white and not any(term.states for term in others)
            gain = _gain(model, samples, equation, column, [*corrections, *others]) if comparable else 0.0
            share = 1.0 / (1.0 + (1.0 - prior) / prior * math.exp(min(max(-gain, -700.0), 700.0)))
            (time,) = column.inner.values()
            found[column.called] = Mirror(samples.state_names[0], share, _input_of(column), time, step)
    return found


def _input_of(column: Column) -> str:
    """The input that an effect has arrive late; empty where it has none."""
    assert column.effect is not None
    return column.effect.names.get(column.effect.effect.nominal, "")


def _gain(model: Program, samples: Trajectories, equation: str, lag: Column, beside: Sequence[Term]) -> float:
    """Log likelihood of the sensor's lag over that of the actuator, both with the simulation's coefficients free.

    0 where one of them could not be followed: that it does not settle is no evidence.
    """
    (sensor,), (time,), arrives = samples.state_names, lag.inner.values(), Term(_input_of(lag))
    own = [*model.dictionary.get(equation, ()), *beside]
    gain = [] if any(getattr(term, "text", term) == arrives.text for term in own) else [arrives]
    plain = replace(model, discrepancy=None, coefficients={}, rows=_fresh(model.rows))

    def of_the_actuator(change: float) -> tuple[float, int]:
        """Likelihood at another time of its lag, and segments of the path."""
        states = [replace(state, rate=f"({state.rate})*{math.exp(-change)!r}") for state in lag.formula.states]
        terms = {equation: [*own, replace(lag.formula, states=())]}
        return _log_likelihood(plain.remembering(states, samples), samples, terms)

    shown = _free_name(f"{sensor}_shown", model, samples)
    lags = f"{sensor} - {shown}"
    # Its time is a coefficient beside that of the input, which the lag of the actuator has too.
    sensors = replace(plain, simulation={**_rates(model), shown: f"({lags})/{time!r}"})
    terms = {equation: [*own, *gain], shown: [Term(lags)]}
    mirrored, pieces = _log_likelihood(sensors, _renamed(samples, sensor, shown), terms)
    logs, cuts = zip(*(of_the_actuator(change) for change in (-NEARBY, 0.0, NEARBY)), strict=True)
    known = _top(*logs)
    # A path of more segments has more starts that are free, and follows any samples better.
    alike = all(cut == pieces for log, cut in zip(logs, cuts, strict=True) if math.isfinite(log))
    if not (math.isfinite(known) and math.isfinite(mirrored) and alike):
        return 0.0
    return mirrored - known


def _top(left: float, middle: float, right: float) -> float:
    """Top of the parabola through three evenly spaced values, or the largest of them where it has none between."""
    bend = left - 2 * middle + right
    if not math.isfinite(bend) or bend >= 0 or middle < max(left, right):
        return max(left, middle, right)
    return middle - (right - left) ** 2 / (8 * bend)


def _log_likelihood(model: Program, data: Trajectories, terms: Mapping[str, Sequence[Any]]) -> tuple[float, int]:
    """Of samples on rows near the estimate, at the likeliest starts; −∞ where no path can be followed. And segments.

    Without what the priors of starts weigh: both lags have as many coefficients and starts.
    """
    model = replace(model, dictionary=terms)
    try:
        (found,) = near_estimate(model, data).assemble(data).values()
    except (InputError, np.linalg.LinAlgError):
        return -math.inf, 0
    return found.log_likelihood() + 0.5 * float(found.rows.noise.log_det), found.rows.segments


def _rates(model: Program) -> Mapping[str, str]:
    assert isinstance(model.simulation, Mapping)
    return model.simulation


def _fresh(rows: Any) -> TrajectoryRows:
    """Rows on a path of the model alone."""
    return replace(rows, added=(), added_to=(), force=0.0).unforced()


def _free_name(name: str, model: Program, data: Trajectories) -> str:
    while name in (*model.states(data), *data.columns):
        name += "_"
    return name


def _renamed(data: Trajectories, name: str, new: str) -> Trajectories:
    """Samples whose state is called otherwise."""
    units = {new if key == name else key: unit for key, unit in data.units.items()}
    return replace(data, states={new: data.states[name]}, units=units)
