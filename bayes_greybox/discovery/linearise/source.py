"""Rows and regressors of one equation near a point, and other data of the same sensors without their errors."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.grid.table import CORRECTION, EFFECT, FREE
from bayes_greybox.discovery.regressors.columns import Values, at_values, first_values
from bayes_greybox.discovery.regressors.regressors import ALWAYS_ZERO, Regressors, hidden_columns
from bayes_greybox.discovery.sensor_errors.channels import ChannelSuspect, Rate, Sizes, run_slices
from bayes_greybox.discovery.sensor_errors.kinematics import KnownError
from bayes_greybox.discovery.sensor_errors.samples import SampleNoise
from bayes_greybox.model.frame import discrepancy_box, features_per_variable
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.model.program import AnyProgram, Program
from bayes_greybox.model.rows.row_kind import RowKind
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.terms import Term

from .near import Point, Rows


class Source(ABC):
    """Rows of one equation.

    Attributes:
        clipped, misread: True at rows where a channel's sensor was at its end, or slipped, by channel.
        known: Errors of states that these and their rates tell; they are put right first.
        sample_noise: Noise on samples that terms are evaluated at.
        n_sensor: Number of sensors that the rows are of.
    """

    def __init__(self, model: Program, train: Trajectories, equation: str, effects: Sequence[BoundEffect]) -> None:
        self.model, self.train, self.equation, self.effects = model, train, equation, effects
        self.clipped: Mapping[str, Bool[np.ndarray, " n"]] = {}
        self.misread: Mapping[str, Bool[np.ndarray, " n"]] = {}
        self.known: Mapping[ChannelSuspect, KnownError] = {}
        self.sample_noise: Mapping[str, SampleNoise] = {}
        self.n_sensor = 1

    @abstractmethod
    def near(self, point: Point) -> Rows:
        """Return rows near a point.

        Raises:
            InputError: No path of the model at that point is near the samples.
        """

    @abstractmethod
    def quantities(self, rows: Rows) -> Mapping[str, Float[np.ndarray, " n_row"]]:
        """Return the quantities that the noise of rows may grow with."""

    @abstractmethod
    def put_right(
        self, data: Trajectories, point: Point, sensors: Sizes, clock: Trajectories, hidden: Sequence[HiddenState] = ()
    ) -> Trajectories:
        """Return data of the same sensors without their errors, with hidden states of a model after."""

    def row_kind(self, point: Point) -> RowKind | None:
        """Return the rows near a point, where rows are linear only near one; None where they are linear."""
        return None

    def with_inputs(self, program: AnyProgram) -> AnyProgram:
        """Return a model whose inputs go between their samples as they do here."""
        between = self.model.rows.interpolation
        if between is None or program.rows.interpolation == between:
            return program
        return replace(program, rows=program.rows.between(between))

    def doubts(self, rows: Rows) -> list[str]:
        """Return contradictions between the rows and any answer, in words."""
        return []


def with_hidden_states(model: Program, hidden: Sequence[HiddenState], train: Trajectories) -> Program:
    """Return the model with hidden states, on which no f depends."""
    if not hidden:
        return model
    return replace(model, discrepancy=model.discrepancy or OrthogonalGP()).remembering(hidden, train)


def modelled_rate(model: Program, data: Trajectories, equation: str, added: Sequence[tuple[Term, float]]) -> Rate:
    """Return the whole modelled rate: that of the simulation and of terms, on any data of the same columns."""
    simulation = model.simulator(data)

    def rate(data: Trajectories) -> np.ndarray:
        total = simulation.on(data, equation)
        for term, coefficient in added:
            total = total + coefficient * np.asarray(term.evaluate(data.columns))
        return total

    return rate


def period_of(data: Trajectories, equation: str) -> float:
    """Return the time in which the studied state goes to and fro; the longest run if it does not."""
    names = [equation] if equation in data.state_names else list(data.state_names) or list(data.input_names)
    runs = run_slices(data.run)
    durations = [float(np.ptp(data.time[rows])) for rows in runs]
    turns = max((sum(_turns(data.column(name)[rows]) for rows in runs) for name in names), default=0)
    return float(min(2 * sum(durations) / turns, max(durations))) if turns else max(durations)


def _turns(values: np.ndarray) -> int:
    """Return the number of turns of values by more than a share of their range."""
    # Less is noise and no turn.
    least = 0.1 * np.ptp(values)
    if least <= 0:
        return 0
    turns, rising, extreme = 0, 0, values[0]
    for value in values.tolist():
        if rising >= 0 and value > extreme or rising <= 0 and value < extreme:
            if rising == 0 and abs(value - values[0]) < least:
                continue
            rising = rising or (1 if value > values[0] else -1)
            extreme = value
        elif rising and abs(value - extreme) > least:
            turns, rising, extreme = turns + 1, -rising, value
    return turns


LAW_FEATURES = {1: 32, 2: 12, 3: 8}
"""Features per variable by default: finer than in a fit, as the gap may be finer, and no chain has to pay for them."""


def regressors_of(
    model: Program, data: Trajectories, equation: str, effects: Sequence[BoundEffect],
    values: Mapping[str, Values] | None = None, shown: Float[np.ndarray, " n_row"] | float = 0.0,
    whole: Trajectories | None = None, kept: Bool[np.ndarray, " n_obs"] | None = None,
) -> Regressors:  # fmt: skip
    """Return free terms, corrections and effects of an equation; of rows `kept` memory goes along `whole` runs.

    Raises:
        InputError: The simulation equals the measurement exactly; a variable of f that is constant or unknown.
    """
    plain, simulation = model.equation_rows(data, equation), model.simulator(data)
    off = simulation.correctable(equation)
    remembers = any(effect.effect.hidden for effect in effects) or any(each.term.states for each in off)
    path = model.rows.nodes(whole or data, equation, simulation, whole=True) if remembers else None
    held = model.rows.held(data)
    # Hidden states follow parameters where these are now; a coefficient is the whole change.
    moved = model.named.moved_through({name: each.here for name, each in model.parameters.items()})
    changed = [(each.term, moved[each.parameter]) for each in off if moved.get(each.parameter)]
    hidden = hidden_columns([term for term, _ in changed], path, held, kept)
    for (term, change), states in zip(changed, hidden, strict=True):
        column = np.asarray(term.evaluate({**plain.columns, **states}), float)
        shown = shown + change * plain.operate(column[:, None])[:, 0]
    rows = replace(plain, measured=plain.measured + shown / plain.gain)
    # Where nobody asked for a discrepancy, it is a function of what moves: an input may be off until the held-out part.
    moving = tuple(name for name, column in rows.columns.items() if np.ptp(column) > 0)
    gp = model.discrepancy or OrthogonalGP(variables=moving or None)
    variables, centre, half_width = discrepancy_box(gp, rows.columns)
    simulation = model.simulator(data)
    per_variable = LAW_FEATURES.get(len(variables))
    default = None if per_variable is None else (per_variable,) * len(variables)
    basis = HilbertBasis(gp.boundary, features_per_variable(gp, len(variables), default))
    regressors = Regressors(variables, centre, half_width, basis, path=path, rows=rows, held=held, kept=kept)
    regressors.freed = [term.parameter for term, _ in changed]
    if model.learns(equation):
        stated = model.stated(equation, data)
        spreads = {name: prior.sd for name, prior in stated.priors.items()}
        free = [(term, {"spread": spreads.get(term.name), "parameter": term.parameter}) for term in stated.learned]
        regressors.add(FREE, free)
    regressors.add(CORRECTION, [(each.term, each.about()) for each in off])
    nominals = simulation.nominals(equation)
    terms = {regressors.columns[i].formula.name for i in regressors.of_kind(FREE)} | set(nominals)
    # An input that acts late on another body, or as a factor, has no lag here.
    idle = [e for e in effects if e.effect.nominal and e.names[e.effect.nominal] not in terms]
    regressors.leave_out({e.slug: "the equation has no term of its own with this input" for e in idle})
    items, without_range = [], []
    for effect in effects:
        if effect in idle:
            continue
        nominal = nominals.get(effect.names.get(effect.effect.nominal, ""), 0.0)
        about = {"nominal": nominal, "direction": -1 if nominals.get(effect.names.get("input", ""), 0.0) < 0 else 1}
        if not effect.effect.inner:
            items.append((effect.term(), {"effect": effect, **about}))
            continue
        chosen = (values or {}).get(effect.label) or first_values(effect, rows.columns, path)
        if chosen is None:
            without_range.append(effect.slug)
        else:
            items += at_values(effect, chosen, **about)
    regressors.add(EFFECT, items)
    regressors.leave_out(dict.fromkeys(without_range, ALWAYS_ZERO))
    return regressors
