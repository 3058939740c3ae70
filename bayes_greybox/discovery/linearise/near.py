"""What rows and regressors are taken near to, and the hypotheses weighed there."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.grid.evidence.set_prior import Window
from bayes_greybox.discovery.grid.hypotheses.weigh import Hypothesis, Weighed
from bayes_greybox.discovery.grid.noise.latent_force import LatentForce
from bayes_greybox.discovery.grid.table import Regressor
from bayes_greybox.discovery.regressors.columns import Column, Values
from bayes_greybox.discovery.regressors.regressors import EFFECT, Regressors
from bayes_greybox.discovery.sensor_errors.channels import DELAY, ChannelSuspect, Rate
from bayes_greybox.model.program import Program
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.terms import Term

from .noise_shapes import Shape

STAYS = 0.3
"""Coefficients that move by less than this share of their posterior standard deviation stay."""

MATTERS = 1e-3
"""Probability from which on something is weighed, and its values are refined, until the likeliest hypothesis stays."""

LARGEST_ERROR, LARGEST_DELAY = 3.0, 2.0
"""An error of a sensor is small: at most so many of its prior standard deviations, or it is no such error."""


@dataclass(frozen=True)
class Point:
    """What rows and regressors are taken near to.

    Attributes:
        added: Terms beside the simulation, with their coefficients.
        sensors: Errors of sensors and inputs that the rows are free of.
        values: Values of nonlinear parameters by the effect's label.
        shapes: Shapes of the noise beside white.
        spread: Relative standard deviations of the sensors' noise; empty where there is one.
        window: What is weighed there; None for everything.
    """

    added: tuple[tuple[Term, float], ...] = ()
    sensors: Mapping[ChannelSuspect, float] = field(default_factory=dict)
    values: Mapping[str, Values] = field(default_factory=dict)
    shapes: tuple[Shape, ...] = ()
    spread: tuple[float, ...] = ()
    window: Window | None = None

    def weighs(self, called: str) -> bool:
        """Return whether an effect, a sensor error or a memory is weighed."""
        return self.window is None or called in self.window.called

    @property
    def hidden(self) -> tuple[HiddenState, ...]:
        """Return the hidden states of the terms."""
        return tuple({state.name: state for term, _ in self.added for state in term.states}.values())


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows and regressors near a point.

    Attributes:
        point: What they are near to.
        model: The model with rows near it.
        data: Training data, free of the sensor errors of the point.
        regressors: Theirs.
        force: How a latent force acts on them.
        rate: The whole modelled rate.
        place: Which of the rows as they came these are: without those that a delay takes out of their run.
        n_all: How many came.
        floor: Least variance of the noise, scaled: rounding.
        unit: Log of the scaled rows' unit in that of the readings, so that evidences near different points compare.
    """

    point: Point
    model: Program
    data: Trajectories
    regressors: Regressors
    force: LatentForce
    rate: Rate
    place: Int[np.ndarray, " n_row"]
    n_all: int
    floor: float
    unit: float = 0.0

    def everywhere(self, values: Float[np.ndarray, " n_row"]) -> Float[np.ndarray, " n_all"]:
        """Return values at all rows as they came, one at those that are out."""
        found = np.ones(self.n_all)
        found[self.place] = values
        return found


@dataclass(frozen=True, eq=False)
class Near:
    """Hypotheses on rows near a point.

    Attributes:
        rows: The rows.
        weighed: The hypotheses.
    """

    rows: Rows
    weighed: Weighed

    @property
    def regressors(self) -> Regressors:
        """Return the regressors."""
        return self.rows.regressors

    @property
    def log_evidence(self) -> float:
        """Return the log evidence of all hypotheses together, of the readings in their own units."""
        logs = [hypothesis.log_weight for hypothesis in self.weighed.hypotheses]
        return float(np.logaddexp.reduce(logs)) - self.log_unit

    @property
    def log_unit(self) -> float:
        """Return what a log weight on these rows is more than that of the readings in their own units."""
        return self.rows.unit * self.regressors.rows.n_row

    @property
    def likeliest(self) -> Hypothesis:
        """Return the likeliest hypothesis."""
        return self.weighed.hypotheses[0]

    def log_weights(self) -> dict[tuple[str, ...], float]:
        """Return log weights by what the regressors of hypotheses are called, summed over values of parameters."""
        found: dict[tuple[str, ...], float] = {}
        for h in self.weighed.hypotheses:
            found[self.names(h)] = float(np.logaddexp(found.get(self.names(h), -np.inf), h.log_weight))
        return found

    @property
    def window(self) -> Window:
        """Return what had some probability: all else is left out until the likeliest hypothesis stays."""
        weighed, found = self.weighed, dict.fromkeys(self.weighed.table.memories, 0.0)
        for h in weighed.hypotheses:
            for name in (*self.names(h), *h.memories):
                found[name] = found.get(name, 0.0) + h.probability * h.memories.get(name, 1.0)
        known = self.rows.point.window
        called = {name for name, probability in found.items() if probability > MATTERS}
        if known is None:
            return Window(frozenset(called), weighed.prior, tuple(weighed.table.memories))
        return known._replace(called=known.called | called)

    def column(self, index: int) -> Column:
        """Return one regressor's column."""
        return self.regressors.columns[index]

    def in_units(self, hypothesis: Hypothesis) -> Float[np.ndarray, " k"]:
        """Return user's units per scaled unit of each coefficient."""
        scale = np.array([self.column(i).scale for i in hypothesis.members])
        return self.regressors.target_scale / scale

    def point_of(self, hypothesis: Hypothesis) -> Point:
        """Return the point that a hypothesis says."""
        sizes = hypothesis.mean * self.in_units(hypothesis)
        columns = [self.column(i) for i in hypothesis.members]
        added = tuple(
            (c.term, float(size)) for c, size in zip(columns, sizes, strict=True) if c.term is not None and size != 0
        )
        sensors = {c.suspect: float(size) for c, size in zip(columns, sizes, strict=True) if c.suspect is not None}
        return replace(self.rows.point, added=added, sensors=sensors)

    def stays(self, before: "Near") -> bool:
        """Return whether the likeliest hypothesis is the one before, its coefficients known no better.

        The coefficient of an effect with nonlinear parameters goes with their values: it is not compared.
        """
        now, then = self.likeliest, before.likeliest
        if self.names(now) != before.names(then):
            return False
        moved = np.abs(now.mean * self.in_units(now) - then.mean * before.in_units(then))
        bent = np.array([bool(self.column(i).inner) for i in now.members], dtype=bool)
        return bool(np.all((moved <= STAYS * now.sd * self.in_units(now)) | bent))

    def names(self, hypothesis: Hypothesis) -> tuple[str, ...]:
        """Return what the regressors of a hypothesis are called, whatever the values of their parameters."""
        return tuple(self.column(i).called for i in hypothesis.members)


def as_regressor(column: Column, gap: float) -> Regressor:
    """Return what the search needs to know of a column.

    Args:
        column: The column.
        gap: RMS of the gap as a force, over that of the target: the scale of effects.
    """
    if column.kind == EFFECT and column.effect is not None:
        effect = column.effect
        return Regressor(
            EFFECT, effect.label, effect.slug, column.sd * gap, effect.effect.family or effect.slug,
            tuple(sorted(set(effect.names.values()))), bool(column.inner), column.log_weight, column.sign,
            column.expected,
        )  # fmt: skip
    limit = np.inf
    if column.suspect is not None:
        limit = LARGEST_DELAY if column.suspect.kind == DELAY else LARGEST_ERROR
    return Regressor(column.kind, f"{column.kind}:{column.called}", column.called, column.sd, limit=limit)
