"""Explanations on rows near one model, along whose path rows are linear, and the likeliest of them."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.evidence.columns import Column
from bayes_greybox.discovery.evidence.evaluations import Evaluations, one_pattern
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.discovery.evidence.of_equation import sufficient_statistics
from bayes_greybox.discovery.evidence.ties import ranked
from bayes_greybox.discovery.evidence.with_discrepancy import Evaluator
from bayes_greybox.discovery.suspects.channels import DELAY, ChannelSuspect, Rate
from bayes_greybox.discovery.suspects.drift import drift_columns
from bayes_greybox.discovery.suspects.memory import memory_columns
from bayes_greybox.discovery.suspects.sensors import unit_of_rows
from bayes_greybox.model.estimate.evidence import coefficients
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.noise.noise_model import CORRELATED, PROCESS, NoiseModel
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.equation_rows import EquationRows
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.terms import Term

from ..alignment import modelled_rate
from ..sets import Sets
from ..worlds import log_noise, under
from .sensors import Suspected, freed

STAYS = 0.3
"""Coefficients that move by less than this share of their posterior standard deviation stay."""

LEVEL = 1.0
"""Nats that the evidence of an effect with an inner parameter may change by where it stays."""


class Near(NamedTuple):
    """Explanations on rows near one model, and the likeliest one's coefficients in user's units.

    `base` are sets under the noise that rows come with; `noise` is the one that the likeliest was found under; `found`
    are terms beside the simulation, `sensors` errors of sensors and inputs, which the path is without: beside an offset
    of a sensor a force is another one. `log_evidence` is that of the likeliest, of the samples in user's units, so that
    paths can be compared: `unit_nats` are those that its unit and the gains of sensors make. `sets` are those that the
    likeliest was found among, under that noise and with columns of their own. `names` are without values of inner
    parameters; `bent` are columns that have one, `inner` their values by the effect's label; `hidden` are hidden states
    of the model, of what was found before.
    """

    model: Program
    data: Trajectories
    base: Sets
    noise: NoiseModel
    rate: Rate
    names: tuple[str, ...]
    values: Float[np.ndarray, " n_column"]
    sd: Float[np.ndarray, " n_column"]
    bent: Bool[np.ndarray, " n_column"]
    found: tuple[tuple[Term, float], ...]
    sensors: Mapping[ChannelSuspect, float]
    log_evidence: float
    inner: Mapping[str, Mapping[str, float]]
    hidden: tuple[HiddenState, ...]
    sets: Sets
    unit_nats: float

    def under_noise(self) -> Sets:
        """Sets under that noise made anew, with the columns that `base` has by now."""
        return under(self.base, self.noise) if self.noise.names else self.base

    def stays(self, before: "Near") -> bool:
        """Whether the likeliest explanation is the one before, up to what its coefficients are known to.

        A coefficient beside an inner parameter goes with its value on a grid: there the evidence says whether it stays.
        """
        if self.names != before.names:
            return False
        stay = np.abs(self.values - before.values) <= STAYS * self.sd
        level = abs(self.log_evidence - before.log_evidence) <= LEVEL
        return bool(np.all(stay | self.bent)) and (level or not np.any(self.bent))


def weigh_near(
    model: Program, train: Trajectories, equation: str, effects: Sequence[BoundEffect], odds: Odds, most: int,
    added: Sequence[tuple[Term, float]], sensors: Mapping[ChannelSuspect, float],
    inner: Mapping[str, Mapping[str, float]], suspected: bool, noise: NoiseModel | None, refuted: Collection[str] = (),
) -> Near:  # fmt: skip
    """Weigh all explanations on rows near one model.

    Args:
        model: The model before.
        train: Samples.
        equation: The learned state.
        effects: Effects bound to columns.
        odds: Prior odds.
        most: Largest number of effects.
        added: Terms that rows are taken near to, beside the simulation, with their coefficients.
        sensors: Errors of sensors and inputs that the path is without.
        inner: Values of inner parameters by the effect's label.
        suspected: Whether errors of sensors are weighed too.
        noise: That of the rows; found among few where it is not known yet.
        refuted: Keys of errors that are left out.

    Raises:
        InputError: No path of this model is near the samples.
    """
    own, hidden = model.states(train), hidden_states(added)
    model = remembering(model, hidden, train)
    # What hangs together in time and is the sensor's is nothing that the path does.
    sensor = noise is not None and CORRELATED in noise.names
    simulation, rows = model.simulator(train), model.rows.around(added)
    right = freed(train.samples or train, equation, sensors, train) if sensors else train
    try:
        near = replace(model, rows=rows.unforced() if sensor else rows)
        data = near.rows.complete(right, equation, simulation)
    except InputError:
        if not sensor:
            raise
        # No path of this model is near the samples: not only the sensor has a memory.
        near, noise = replace(model, rows=rows), None
        data = near.rows.complete(right, equation, simulation)
    rate = modelled_rate(near, data, equation, added)
    if suspected:
        beside = Suspected.of(near, data, equation, added, sensors, rate, hidden)
        statistics = sufficient_statistics(near, data, equation, effects, beside.shown, inner)
        told = [each for each in beside.told(statistics) if each[0].key not in refuted]
        statistics.suspect(told, at_rows=True)
        statistics.suspect([each for each in beside.inputs if each[0].key not in refuted])
        # What a hidden state did before is what it is.
        shown = replace(beside.nodes, states={name: beside.nodes.states[name] for name in own})
        statistics.remember(chain(memory_columns(shown), drift_columns(shown)))
    else:
        statistics = sufficient_statistics(near, data, equation, effects, found=inner)
    evaluator = Evaluator(statistics.prior, statistics.kernel, np.asarray(statistics.basis.frequency))
    base = Sets(Evaluations(statistics, odds, evaluator), most)
    white = statistics.rows.noise
    if noise is None:
        tried = [NoiseModel(white), *_unfollowed(statistics.rows)]
    else:
        tried = [replace(noise, noise=noise.noise.onto(white))]
    weighed: list[tuple[float, Sets, NoiseModel]] = []
    for known in tried:
        # One after the other: values of inner parameters that the first noise asked for serve the second too.
        under_it = under(base, known) if known.names else base
        weighed.append((_log_evidence(under_it, known), under_it, known))
    _, sets, noise = ranked(weighed, lambda each: each[0])[0]
    unit = statistics.target_scale * statistics.rows.gain
    # Of the samples as they came: those freed of a gain are over it.
    over = unit_of_rows(right.samples or right, sensors)
    unit_nats = statistics.rows.n_row * (math.log(unit) + over)
    log_evidence = _log_evidence(sets, noise) - unit_nats
    columns, values, sd = estimate(sets, sets.likeliest())
    found, off, values_of = acting(columns, values), errors(columns, values), inner_values(columns)
    names, bent = tuple(map(_named, columns)), np.array([bool(c.inner) for c in columns], dtype=bool)
    names, values = _of_one_clock(columns, names, values, train)
    return Near(
        near, data, base, noise, rate, names, values, sd, bent, found, off, log_evidence, values_of, hidden, sets,
        unit_nats,
    )  # fmt: skip


def evidence_of(near: Near, core: Sequence[int]) -> float:
    """Log evidence of one of the `sets` near a model, as that of the likeliest: inner parameters refined as there."""
    near.sets.refine(core)
    return _log_evidence(near.sets, near.noise, core) - near.unit_nats


def hidden_states(added: Sequence[tuple[Term, float]]) -> tuple[HiddenState, ...]:
    """Hidden states of terms."""
    return tuple({state.name: state for term, _ in added for state in term.states}.values())


def remembering(model: Program, hidden: Sequence[HiddenState], train: Trajectories) -> Program:
    """The model with hidden states, on which no f that is weighed depends."""
    if not hidden:
        return model
    return replace(model, discrepancy=model.discrepancy or OrthogonalGP()).remembering(hidden, train)


def estimate(
    sets: Sets, core: Sequence[int]
) -> tuple[list[Column], Float[np.ndarray, " n_column"], Float[np.ndarray, " n_column"]]:
    """Columns of a set with the simulation's own, their posterior means and standard deviations; user's units."""
    statistics, fitted = sets.statistics, sets.parametric(core)
    mean, covariance = coefficients(*one_pattern(fitted, int(np.argmax(fitted.by_pattern))))
    columns = [statistics.columns[i] for i in sets.evaluations.indices(core)]
    unit = np.array([statistics.target_scale / column.scale for column in columns])
    return columns, unit * mean, unit * np.sqrt(np.maximum(np.diag(covariance), 0.0))


def acting(columns: Sequence[Column], values: Float[np.ndarray, " n_column"]) -> tuple[tuple[Term, float], ...]:
    """Terms that act along the path, with their coefficients."""
    return tuple((c.term, float(v)) for c, v in zip(columns, values, strict=True) if c.term is not None and v != 0)


def errors(columns: Sequence[Column], values: Float[np.ndarray, " n_column"]) -> dict[ChannelSuspect, float]:
    """Errors of sensors and inputs, of a unit of their size."""
    return {c.suspect: float(v) for c, v in zip(columns, values, strict=True) if c.suspect is not None}


def inner_values(columns: Sequence[Column]) -> dict[str, Mapping[str, float]]:
    """Values of inner parameters by the effect's label."""
    return {c.effect.label: c.inner for c in columns if c.effect is not None and c.inner}


def _named(column: Column) -> str:
    if column.suspect is not None:
        return column.suspect.key
    return column.formula.text if column.effect is None else column.effect.text()


def _of_one_clock(
    columns: Sequence[Column], names: tuple[str, ...], values: Float[np.ndarray, " n_column"], train: Trajectories
) -> tuple[tuple[str, ...], Float[np.ndarray, " n_column"]]:
    """Names and coefficients, a delay of the only input as that of the only sensor: late is one against the other."""
    samples = train.samples or train
    if not len(samples.state_names) == len(samples.input_names) == 1:
        return names, values
    late = np.array([c.suspect is not None and c.suspect.kind == DELAY for c in columns], dtype=bool)
    sign = [-1.0 if c.suspect is not None and c.suspect.channel in samples.input_names else 1.0 for c in columns]
    return (
        tuple(DELAY if is_late else name for name, is_late in zip(names, late, strict=True)),
        np.where(late, sign, 1.0) * values,
    )


def _unfollowed(rows: EquationRows) -> list[NoiseModel]:
    """Noise with what the model does not follow of the path, if there is anything."""
    if rows.unfollowed is None or rows.unfollowed.nats <= 0:
        return []
    about = {PROCESS: {"share": 1.0, "intensity": 0.0}}
    return [NoiseModel(rows.noise.forced(rows.unfollowed.intensity), (PROCESS,), about=about)]


def _log_evidence(sets: Sets, noise: NoiseModel, core: Sequence[int] | None = None) -> float:
    """Of a set without a rest, all priors included, by default the likeliest; inner parameters are summed over."""
    core, known = sets.likeliest() if core is None else tuple(core), sets.evaluations
    top = sets.parametric(core).all
    total = top + sets.log_prior(core) + sets.log_beside(core) + log_noise(noise, sets.odds)
    for index in core:
        if sets.statistics.columns[index].inner:
            values = [tuple(other if i == index else i for i in core) for other in known.group(index)]
            total += float(np.logaddexp.reduce([each.all for each in sets.each_parametric(values)])) - top
    return total
