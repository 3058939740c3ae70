"""Linearisation point of rows and regressors, the hypotheses weighed there, and the shapes of noise they speak for.

The white residual of the likeliest hypothesis speaks for heavy tails, and for noise that grows with some quantity. They
become further points of the noise grid, each with its prior and with the cost of its parameters.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.data.noise.weighted import WhiteNoise, correlation_and_sd
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.grid.latent_force import LatentForce
from bayes_greybox.discovery.grid.sets import Reach, Window
from bayes_greybox.discovery.grid.table import EFFECT, Regressor
from bayes_greybox.discovery.grid.weigh import Hypothesis, Weighed
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.discovery.regressors.columns import Column, Values
from bayes_greybox.discovery.regressors.regressors import CORRECTION_SCALE, Regressors
from bayes_greybox.discovery.sensor_errors.channels import DELAY, DEPARTURE, NOISE, Rate, Sizes
from bayes_greybox.model.gp.hyper import NoisePrior
from bayes_greybox.model.noise.noise_model import NoiseModel
from bayes_greybox.model.noise.suspicions import LEAST_ROWS, heavy, varying
from bayes_greybox.model.program import Program
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.parameters import step_to
from bayes_greybox.physics.terms import Term

AtRows = Float[np.ndarray, " n_row"]


class Shape(NamedTuple):
    """One shape of the noise: relative standard deviations of the rows as they came.

    `log_prior` is added to that of a noise point: the prior odds of the shape, and its parameters' cost.
    """

    name: str
    spread: AtRows
    log_prior: float
    about: Mapping[str, Any]


def noise_shapes(white: AtRows, quantities: Mapping[str, AtRows], odds: Odds) -> tuple[Shape, ...]:
    """Return the shapes that a residual speaks for, down to log posterior odds of −3 over white noise."""
    if len(white) < LEAST_ROWS or not np.all(np.isfinite(white)):
        return ()
    plain, prior = NoiseModel(WhiteNoise((len(white),))), NoisePrior(1e-6, 1.0)
    log_odds = math.log(odds.noise) - math.log1p(-odds.noise)

    def grows(model: NoiseModel) -> Any:
        return varying(white, model, quantities, prior)

    def has_tails(model: NoiseModel) -> Any:
        return heavy(white, model, prior)

    def likely(suspicion: Any) -> bool:
        return suspicion is not None and suspicion.log_bayes_factor + log_odds > -3.0

    worth = [s for s in (grows(plain), has_tails(plain)) if likely(s)]
    if len(worth) == 2:
        # Noise that grows has heavy tails, too: beside the growth tails are those that are left.
        first = max(worth, key=lambda s: s.log_bayes_factor)
        both = (has_tails if first is worth[0] else grows)(first.model)
        worth += [both] if likely(both) else []
    return tuple(_shape(suspicion.model, log_odds) for suspicion in worth)


def _shape(model: NoiseModel, log_odds: float) -> Shape:
    _, sd = correlation_and_sd(model.noise)
    return Shape(" + ".join(model.names), np.asarray(sd), len(model.names) * log_odds + model.constant, model.about)


SETTLED_SHARE = 0.3
"""Coefficients that move by less than this share of their posterior standard deviation stay."""

MATTERS = 1e-3
"""Least probability of an effect, an error or a memory to be weighed and refined until the likeliest hypothesis
stays."""

LARGEST_ERROR, LARGEST_DELAY = 3.0, 2.0
"""An error of a sensor is small: at most so many of its prior standard deviations, or it is no such error."""


@dataclass(frozen=True)
class Point:
    """Linearisation point of rows and regressors.

    Attributes:
        added: Terms beside the simulation, with their coefficients.
        parameters: Values of named parameters that are not what the model says.
        shapes: Shapes of the noise beside white.
        spread: Relative standard deviations of the sensors' noise; empty where there is one sensor.
        window: Effects, errors and memories that are weighed there; None for all.
    """

    added: tuple[tuple[Term, float], ...] = ()
    sensors: Sizes = field(default_factory=dict)
    values: Mapping[str, Values] = field(default_factory=dict)
    shapes: tuple[Shape, ...] = ()
    spread: tuple[float, ...] = ()
    window: Window | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)

    def weighs(self, called: str) -> bool:
        """Return true if an effect, a sensor error or a memory is weighed."""
        return self.window is None or called in self.window.called

    @property
    def hidden(self) -> tuple[HiddenState, ...]:
        """Return the hidden states of the terms."""
        return tuple({state.name: state for term, _ in self.added for state in term.states}.values())


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows and regressors near a point, on data that are free of the sensor errors there.

    Attributes:
        place: Places of these rows among all: a delay takes some out of their run.
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


@dataclass(frozen=True, eq=False)
class Near:
    """Hypotheses on rows near a point."""

    rows: Rows
    weighed: Weighed

    @property
    def regressors(self) -> Regressors:
        """Return the regressors."""
        return self.rows.regressors

    @property
    def log_evidence(self) -> float:
        """Return the log evidence of all hypotheses together, of the readings in their own units."""
        return float(np.logaddexp.reduce([h.log_weight for h in self.weighed.hypotheses])) - self.log_unit

    @property
    def log_unit(self) -> float:
        """Return the excess of a log weight on these rows over that of the readings in their own units."""
        return self.rows.unit * self.regressors.rows.n_row

    @property
    def likeliest(self) -> Hypothesis:
        """Return the likeliest hypothesis."""
        return self.weighed.hypotheses[0]

    def log_weights(self) -> dict[tuple[str, ...], float]:
        """Return log weights by the names of a hypothesis's regressors, summed over values of parameters."""
        sums: dict[tuple[str, ...], float] = {}
        for h in self.weighed.hypotheses:
            sums[self.names(h)] = float(np.logaddexp(sums.get(self.names(h), -np.inf), h.log_weight))
        return sums

    def log_weight_alone(self, label: str, reach: Reach) -> float:
        """Return the log weight of the likeliest hypothesis that leaves nothing, with this effect alone; −∞ without.

        It has no error of a sensor.
        """
        columns, of_effect = enumerate(self.regressors.columns), self.regressors.group(label)
        own = [i for i, column in columns if column.effect is None and column.suspect is None]
        members, log_weight = self.weighed.likeliest_among([*own, *of_effect], reach)
        has = not label or set(members).intersection(of_effect)
        return log_weight - self.log_unit if has else -np.inf

    @property
    def window(self) -> Window:
        """Return the names that had some probability: all others are left out until the likeliest hypothesis stays."""
        weighed, sums = self.weighed, dict.fromkeys(self.weighed.table.memories, 0.0)
        for h in weighed.hypotheses:
            for name in (*self.names(h), *h.memories):
                sums[name] = sums.get(name, 0.0) + h.probability * h.memories.get(name, 1.0)
        called = frozenset(name for name, probability in sums.items() if probability > MATTERS)
        before = self.rows.point.window
        if before is None:
            return Window(called, weighed.prior, tuple(weighed.table.memories))
        return before._replace(called=before.called | called)

    def column(self, index: int) -> Column:
        """Return one regressor's column."""
        return self.regressors.columns[index]

    def names(self, hypothesis: Hypothesis) -> tuple[str, ...]:
        """Return the names of a hypothesis's regressors, whatever the values of their parameters."""
        return tuple(self.column(i).called for i in hypothesis.members)

    def in_units(self, hypothesis: Hypothesis) -> Float[np.ndarray, " k"]:
        """Return user's units per scaled unit of each coefficient."""
        scale = np.array([self.column(i).scale for i in hypothesis.members])
        return self.regressors.target_scale / scale

    def point_of(self, hypothesis: Hypothesis) -> Point:
        """Return the linearisation point at the mode of a hypothesis."""
        sizes = (hypothesis.mean * self.in_units(hypothesis)).tolist()
        columns = [(self.column(i), size) for i, size in zip(hypothesis.members, sizes, strict=True)]
        moved = {c.parameter: size for c, size in columns if c.parameter and size != 0}
        terms = ((c, size) for c, size in columns if not c.parameter)
        added = tuple((c.term, size) for c, size in terms if c.term is not None and size != 0)
        sensors = {c.suspect: size for c, size in columns if c.suspect is not None}
        given, parameters = self.rows.model.parameters, {}
        for name, size in moved.items():
            # Of a parameter that is zero nothing says how far is far.
            spread = given[name].sd or abs(CORRECTION_SCALE * given[name].value) or math.inf
            parameters[name] = step_to(given[name].value + size, given[name].here, spread)
        return replace(self.rows.point, added=added, sensors=sensors, parameters=parameters)

    @property
    def on_tangent(self) -> bool:
        """Return true if tangents are taken where the likeliest hypothesis has its parameters."""
        likeliest, given = self.likeliest, self.rows.model.parameters
        units = self.in_units(likeliest)
        moves = {}
        for i, size, sd in zip(likeliest.members, likeliest.mean * units, likeliest.sd * np.abs(units), strict=True):
            name = self.column(i).parameter
            if name and abs(given[name].value + size - given[name].here) > SETTLED_SHARE * sd:
                moves[name] = size
        return not self.rows.model.named.bends(self.regressors.equation, moves)

    def stays(self, before: "Near") -> bool:
        """Return true if the likeliest hypothesis is the one before, its coefficients known no better.

        The coefficient of an effect with nonlinear parameters goes with their values: it is not compared.
        """
        now, then = self.likeliest, before.likeliest
        if self.names(now) != before.names(then):
            return False
        moved = np.abs(now.mean * self.in_units(now) - then.mean * before.in_units(then))
        nonlinear = np.array([bool(self.column(i).inner) for i in now.members], dtype=bool)
        return bool(np.all((moved <= SETTLED_SHARE * now.sd * self.in_units(now)) | nonlinear))


def as_regressor(column: Column, size: float) -> Regressor:
    """Return the prior and names of a column, for the search."""
    if column.kind == EFFECT and column.effect is not None:
        effect = column.effect
        return Regressor(
            EFFECT, effect.label, effect.slug, column.sd * size,
            tuple(sorted(set(effect.names.values()))), bool(column.inner), column.log_weight, column.sign,
            column.expected,
        )  # fmt: skip
    limits, log_weight, expected, sure = column.limits, column.log_weight, 0.0, ""
    if column.suspect is not None:
        expected, sure = column.sd * column.suspect.expected / column.suspect.sd, column.suspect.sure
        limit = LARGEST_DELAY if column.suspect.kind == DELAY else LARGEST_ERROR
        limits = (-limit, limit)
        if column.suspect.kind in (NOISE, DEPARTURE):
            # These have no sign: all of their prior is above zero.
            limits, log_weight = (0.0, limit), log_weight + math.log(2)
    return Regressor(
        column.kind, f"{column.kind}:{column.called}", column.called, column.sd, log_weight=log_weight,
        expected=expected, limits=limits, sure=sure,
    )  # fmt: skip
