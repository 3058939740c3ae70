"""What is missing along the path of a system: its rows are linear near a model, and that model is what was found.

Every explanation is weighed on the rows near one model, the likeliest explanation of the turn before, until it stays
the same. An explanation far from that model fits badly in any case; one that fits as well is near it, since both follow
the same samples. Where what was found remembers, its hidden states are states of the model; those of the others are
followed along its path.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.data.clipping import clipped_states
from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.evidence.columns import Column
from bayes_greybox.discovery.evidence.evaluations import Evaluations, one_pattern
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.discovery.evidence.of_equation import sufficient_statistics
from bayes_greybox.discovery.evidence.with_discrepancy import Evaluator
from bayes_greybox.discovery.suspects.channels import DELAY, GAIN, ChannelSuspect, Rate, as_shown
from bayes_greybox.discovery.suspects.drift import drift_columns
from bayes_greybox.discovery.suspects.memory import memory_columns
from bayes_greybox.model.estimate.evidence import coefficients
from bayes_greybox.model.estimate.near import near_estimate
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.noise.noise_model import CORRELATED, PROCESS, NoiseModel
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.equation_rows import EquationRows
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.terms import Term

from .alignment import Aligned, modelled_rate
from .sensors_along_path import Suspected, freed, put_right
from .sets import Sets
from .worlds import under, worlds

TURNS = 5
"""How often rows are taken anew near what was found."""

STAYS = 0.3
"""Coefficients that move by less than this share of their posterior standard deviation stay."""

FALLS = 3.0
"""Nats by which the evidence may be less on rows near an error of a sensor than it was without: odds of twenty. Beyond,
the error looked likely only near something else."""

CLOSE = 100.0
"""Nats below an effect's evidence down to which a law next to it is followed along a path of its own."""

LEVEL = 1.0
"""Nats that the evidence of an effect with an inner parameter may change by where it stays."""


@dataclass(frozen=True)
class Followed(Aligned):
    """Data along the path, and the sets weighed on them.

    Attributes:
        model: The model with rows near what was found before.
        after: The model with rows near what was found.
        sensors: Errors of sensors and inputs that the path is without.
        clock: Data that drifts were found on.
    """

    model: Program = field(kw_only=True)
    after: Program = field(kw_only=True)
    sensors: Mapping[ChannelSuspect, float] = field(default_factory=dict)
    clock: Trajectories = field(kw_only=True)

    @property
    def n_sensor(self) -> int:
        """As many as states were sampled."""
        assert self.data.samples is not None
        return len(self.data.samples.state_names)

    @property
    def spurious(self) -> float:
        """Nothing: the noise of samples is the rows' own."""
        return 0.0

    @property
    def rates_measured(self) -> bool:
        """No: rates are those of the path."""
        return False

    def shown(self, name: str) -> Float[np.ndarray, " n_obs"]:
        """The path with the errors of its sensor."""
        # The path of an only sensor that is late has its clock already.
        errors = {s: size for s, size in self.sensors.items() if s.kind != DELAY or self.n_sensor > 1}
        return as_shown(self.data.column(name)[None], name, self.data, errors, self.clock)[0]

    def corrected(self, data: Trajectories) -> Trajectories:
        """Any samples of the same sensors with the path through them."""
        return self.model.rows.complete(data, self._equation, self.model.simulator(data))

    def moved(self, data: Trajectories) -> Trajectories:
        """Such data."""
        return self.corrected(data)

    def put_right(
        self, data: Trajectories, sensors: Mapping[ChannelSuspect, float], clock: Trajectories
    ) -> Trajectories:
        """Samples freed of errors of their sensors, with the path through them that right inputs drive."""
        samples = put_right(data.samples or data, self._equation, sensors, clock)
        return self.after.rows.complete(samples, self._equation, self.after.simulator(samples))


def follow(
    quantities: "Callable[[Near], Mapping[str, np.ndarray]]", model: Program, train: Trajectories, equation: str,
    effects: Sequence[BoundEffect], odds: Odds, most: int, report: Callable[[str], None] = lambda text: None,
) -> Followed:  # fmt: skip
    """Find what is missing, the rows taken near it in turns.

    Args:
        quantities: What the noise may grow with, of explanations near a model.
        model: The model before.
        train: Samples.
        equation: The learned state.
        effects: Effects bound to columns.
        odds: Prior odds.
        most: Largest number of effects.
        report: Told in words what is being done.
    """

    def taken(
        before: Near, suspected: bool = False, noise: NoiseModel | None = None, refuted: frozenset[str] = frozenset()
    ) -> Near:
        report("following it with what was found")
        found = before.found, before.sensors, before.inner
        return _near(model, train, equation, effects, odds, most, *found, suspected, noise, refuted)

    report("following the path of the samples")
    # Twice before noise is weighed: far from the right model a small change of the path goes on otherwise than the
    # equations say, which looks like noise that hangs together.
    near = _near(model, train, equation, effects, odds, most, _own_terms(model, train), {}, {}, False, None)
    near = taken(near)
    for suspected in (False, True):
        # Far from the right model the rows are not quite linear, which looks like a sensor that is a little off:
        # sensors are suspected once a path nearer by shows nothing else.
        noise = worlds(near.base, quantities(near), report, near.noise)[0].model
        nearer = partial(taken, suspected=suspected, noise=noise)
        near = _settled(near, nearer)
    _weigh_laws(near, nearer)
    used = np.ones(near.data.n_obs, bool)
    bare = modelled_rate(near.model, near.data, equation, ())
    samples, hidden = near.data.samples or near.data, hidden_states(near.found)
    after = _remembering(model, hidden, train)
    after = replace(after, rows=after.rows.around(near.found))
    try:
        after.rows.complete(samples, equation, after.simulator(samples))
    except InputError:
        # What is likeliest leads away from the samples: they are compared with rows where it was found.
        after, hidden = near.model, near.hidden
    return Followed(
        near.data, near.base, clipped=clipped_states(train.samples or train), rate=near.rate, bare=bare, used=used,
        rows=after.rows, noise=near.noise, hidden=hidden, model=near.model, after=after, sensors=near.sensors,
        clock=train,
    )  # fmt: skip


def hidden_states(added: Sequence[tuple[Term, float]]) -> tuple[HiddenState, ...]:
    """Hidden states of terms."""
    return tuple({state.name: state for term, _ in added for state in term.states}.values())


def _remembering(model: Program, hidden: Sequence[HiddenState], train: Trajectories) -> Program:
    """The model with hidden states, on which no f that is weighed depends."""
    if not hidden:
        return model
    return replace(model, discrepancy=model.discrepancy or OrthogonalGP()).remembering(hidden, train)


def _own_terms(model: Program, train: Trajectories) -> tuple[tuple[Term, float], ...]:
    """The model's own terms with their estimate: where all of an equation is learned, nothing else follows a path."""
    if not model.dictionary:
        return ()
    try:
        (equation,) = near_estimate(model, train).assemble(train).values()
    except (InputError, np.linalg.LinAlgError):
        # The study follows the samples all the same, if less surely.
        return ()
    return tuple(equation.ridge())


class Near(NamedTuple):
    """Explanations on rows near one model, and the likeliest one's coefficients in user's units.

    `base` are sets under the noise that rows come with; `noise` is the one that the likeliest was found under; `found`
    are terms beside the simulation, `sensors` errors of sensors and inputs, which the path is without: beside an offset
    of a sensor a force is another one. `log_evidence` is that of the likeliest, of the samples in user's units, so that
    paths can be compared. `names` are without values of inner parameters; `bent` are columns that have one, `inner`
    their values by the effect's label; `hidden` are hidden states of the model, of what was found before.
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
    inner: Mapping[str, float]
    hidden: tuple[HiddenState, ...]

    def stays(self, before: "Near") -> bool:
        """Whether the likeliest explanation is the one before, up to what its coefficients are known to.

        A coefficient beside an inner parameter goes with its value on a grid: there the evidence says whether it stays.
        """
        if self.names != before.names:
            return False
        stay = np.abs(self.values - before.values) <= STAYS * self.sd
        level = abs(self.log_evidence - before.log_evidence) <= LEVEL
        return bool(np.all(stay | self.bent)) and (level or not np.any(self.bent))


def _settled(near: Near, taken: Callable[..., Near]) -> Near:
    """The explanation that stays, rows taken anew near it in turns.

    On rows near one model an error of a sensor may look likely that is no explanation near itself, as a late sensor
    does beside an actuator that lags: its column is a slope along the wrong path. Such an error is left out.

    Args:
        near: The explanation before.
        taken: From an explanation, and the keys of errors that are left out, to the likeliest one on rows near it.
    """
    best, earlier, refuted, turns = None, None, frozenset(), 0
    while turns < TURNS:
        before = near
        near = taken(before, refuted=refuted)
        fresh = _errors(before) - _errors(earlier) if earlier is not None else frozenset()
        if earlier is not None and fresh and near.log_evidence < earlier.log_evidence - FALLS:
            near, best, refuted = earlier, None, refuted | fresh
            earlier = None
            continue
        earlier, turns = before, turns + 1
        best = near if best is None or near.log_evidence > best.log_evidence else best
        if near.stays(before):
            return near
    # Two explanations may lead to each other by turns.
    return best or near


def _weigh_laws(near: Near, taken: Callable[[Near], Near]) -> None:
    """Put the laws next to what was found on equal footing with it: each is weighed on rows near itself.

    A law that fits as well has a path of its own; on rows near another one it fits worse. What rows near itself say
    more of it is added to its weight.

    Args:
        near: The explanation that stays.
        taken: From an explanation to the likeliest one on rows near it.
    """
    core = _under(near).likeliest()
    places = {i: near.base.laws(i) for i in core}
    if any(near.base.statistics.columns[i].inner for i in core) or not any(places.values()):
        return
    known = _under(near)
    level = known.parametric(core).all
    columns = near.base.statistics.columns
    errors = tuple(j for j in core if columns[j].suspect is not None)
    for i, laws in places.items():
        # Beside the errors alone: off its own path a law needs the company of others.
        names = [_label(columns[j]) for j in (*errors, i)]
        for law in laws:
            if known.parametric((*errors, law)).all < level - CLOSE:
                continue
            column = columns[law]
            try:
                here, found = _of_law(near, names, column.formula.text)
                there, found = _of_law(taken(near._replace(found=found)), names, column.formula.text)
                there, _ = _of_law(taken(near._replace(found=found)), names, column.formula.text)
            except (InputError, LookupError, np.linalg.LinAlgError):
                # Rows near another law may not have what stands beside it; it stays where it is.
                continue
            columns[law] = replace(column, log_weight=max(there - here, 0.0))


def _of_law(near: Near, names: Sequence[str], law: str) -> tuple[float, tuple[tuple[Term, float], ...]]:
    """Log evidence of errors with a law in the place of the effect, the last of these names, and its terms.

    Raises:
        LookupError: One of them is no column of these rows.
    """
    own = {_label(c): i for i, c in enumerate(near.base.statistics.columns) if c.kind in ("effect", "suspect")}
    core = [own[name] for name in names]
    each = near.base.laws(core[-1])
    columns = near.base.statistics.columns
    core[-1] = {columns[i].formula.text: i for i in each}[law]
    sets = _under(near)
    estimated, values, _ = _estimate(sets, core)
    unit = sets.statistics.target_scale * sets.statistics.rows.gain
    value = sets.parametric(core).all - sum(columns[i].log_weight for i in core)
    value -= 0.5 * near.noise.noise.log_det + sets.statistics.rows.n_row * math.log(unit)
    return value, _terms(estimated, values)


def _under(near: Near) -> Sets:
    return under(near.base, near.noise) if near.noise.names else near.base


def _label(column: Column) -> str:
    """An error, or an effect on its columns."""
    if column.suspect is not None:
        return column.suspect.key
    return column.formula.text if column.effect is None else column.effect.label


def _errors(near: Near) -> frozenset[str]:
    """Keys of the errors of sensors that were found."""
    return frozenset(suspect.key for suspect in near.sensors)


def _near(
    model: Program, train: Trajectories, equation: str, effects: Sequence[BoundEffect], odds: Odds, most: int,
    added: Sequence[tuple[Term, float]], sensors: Mapping[ChannelSuspect, float], inner: Mapping[str, float],
    suspected: bool, noise: NoiseModel | None, refuted: Collection[str] = (),
) -> Near:  # fmt: skip
    own, hidden = model.states(train), hidden_states(added)
    model = _remembering(model, hidden, train)
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
        beside = Suspected.of(near, data, equation, added, sensors, rate)
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
    each = [(under(base, known) if known.names else base, known) for known in tried]
    sets, noise = max(each, key=lambda pair: _log_evidence(*pair))
    unit = statistics.target_scale * statistics.rows.gain
    log_evidence = _log_evidence(sets, noise) - statistics.rows.n_row * math.log(unit)
    # Of the samples as they came: those freed of a gain are over it.
    gains = [size for suspect, size in sensors.items() if suspect.kind == GAIN and suspect.channel in train.state_names]
    log_evidence -= (
        statistics.rows.n_row / len((train.samples or train).state_names) * sum(math.log1p(size) for size in gains)
    )
    columns, values, sd = _estimate(sets, sets.likeliest())
    names, bent = tuple(map(_named, columns)), np.array([bool(c.inner) for c in columns])
    off = {c.suspect: float(v) for c, v in zip(columns, values, strict=True) if c.suspect is not None}
    values_of = {c.effect.label: next(iter(c.inner.values())) for c in columns if c.effect is not None and c.inner}
    found = _terms(columns, values)
    return Near(near, data, base, noise, rate, names, values, sd, bent, found, off, log_evidence, values_of, hidden)


def _estimate(
    sets: Sets, core: Sequence[int]
) -> tuple[list[Column], Float[np.ndarray, " n_column"], Float[np.ndarray, " n_column"]]:
    """Columns of a set with the simulation's own, their posterior means and standard deviations; user's units."""
    statistics, fitted = sets.statistics, sets.parametric(core)
    mean, covariance = coefficients(*one_pattern(fitted, int(np.argmax(fitted.by_pattern))))
    columns = [statistics.columns[i] for i in sets.evaluations.indices(core)]
    unit = np.array([statistics.target_scale / column.scale for column in columns])
    return columns, unit * mean, unit * np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _named(column: Column) -> str:
    if column.suspect is not None:
        return column.suspect.key
    return column.formula.text if column.effect is None else column.effect.text()


def _terms(columns: Sequence[Column], values: Float[np.ndarray, " n_column"]) -> tuple[tuple[Term, float], ...]:
    """Terms that act along the path, with their coefficients."""
    return tuple((c.term, float(v)) for c, v in zip(columns, values, strict=True) if c.term is not None and v != 0)


def _unfollowed(rows: EquationRows) -> list[NoiseModel]:
    """Noise with what the model does not follow of the path, if there is anything."""
    if rows.unfollowed is None or rows.unfollowed.nats <= 0:
        return []
    about = {PROCESS: {"share": 1.0, "intensity": 0.0}}
    return [NoiseModel(rows.noise.forced(rows.unfollowed.intensity), (PROCESS,), about=about)]


def _log_evidence(sets: Sets, noise: NoiseModel) -> float:
    """Of the likeliest set without a rest, prior included; summed over values of inner parameters, one at a time."""
    core, known = sets.likeliest(), sets.evaluations
    top = sets.parametric(core).all
    total = top + sets.log_prior(core) - 0.5 * noise.noise.log_det
    for index in core:
        if sets.statistics.columns[index].inner:
            values = [tuple(other if i == index else i for i in core) for other in known.group(index)]
            total += float(np.logaddexp.reduce([sets.parametric(each).all for each in values])) - top
    return total
