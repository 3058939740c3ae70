"""The right-hand side of an FMU."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import sympy
from jaxtyping import Array, Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.formula.grammar import symbol
from bayes_greybox.physics.simulation.code import flat, undefined
from bayes_greybox.physics.simulation.protocol import (
    CENTRAL_DIFFERENCE_STEP,
    Input,
    Inputs,
    Jacobians,
    Simulation,
    State,
    States,
    Times,
)
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError

from .description import require_units
from .given import FMU
from .running import Reading, running

STEPPED_DIFFERENCE_STEP = 1e-3
"""Step of central differences where rates are differences themselves, whose errors a shorter one would show."""

DERIVATIVE_TOLERANCE = 1e-4
"""Share of an entry's size, or of its rate over the size of its state, by which they may differ."""


@dataclass(frozen=True)
class FMUSimulation(Simulation):
    """An FMU as a simulation: states that it does not have stand still."""

    given: FMU

    @property
    def differentiable(self) -> bool:
        """False: an FMU has first derivatives, and no trace."""
        return False

    @property
    def _equations(self) -> tuple[str, ...]:
        return (*self.given.state_columns, *self.given.outputs)

    def _rate(self, t: Array, x: State, u: Input) -> State:
        # Many points at once are one call from JAX to the FMU.
        return traced(Rates(self))(jnp.asarray(t, float), jnp.asarray(x, float), jnp.asarray(u, float))

    def _on(self, data: Trajectories, state: str) -> np.ndarray:
        t, x, u = data.time, data.matrix(self.states), data.matrix(self.inputs)
        if state in self.given.outputs:
            values = self.values_of(state, t, x, u)
        elif state in self.given.state_columns:
            values = self._rates(t, x, u)[:, self.states.index(state)]
        else:
            return np.zeros(data.n_obs)
        messages = [*running(self.given.description).messages]
        if messages and not np.all(np.isfinite(values)):
            raise InputError(f"The FMU {self.given.description.name} refuses some of the data: {messages[-1]}.")
        return values

    def _rates(self, t: Times, x: States, u: Inputs) -> States:
        """Return g at many points, NaN where the FMU refuses one."""
        points = flat(t, x, u)
        rates, dynamics = np.zeros(points[1].shape), self.given.dynamics
        refs = [rate.ref for _, rate in dynamics if rate is not None]
        if len(refs) == len(dynamics):
            rates[:, self._places] = self._read(*points, refs)
        else:
            states = [state.ref for state, _ in dynamics]
            rates[:, self._places] = self._at(*points, len(states), lambda fmu: fmu.stepped(states))
        return rates.reshape(x.shape)

    def _output(self, name: str, t: Any, x: Any, u: Any) -> Any:
        if name not in self.given.outputs:
            return super()._output(name, t, x, u)
        if isinstance(x, np.ndarray):
            return self.values_of(name, t, x, u)
        return jax.vmap(traced(Rates(self, name)))(t, x, u)

    def values_of(self, name: str, t: Times, x: States, u: Inputs) -> Times:
        """Return an output at many points, NaN where the FMU refuses one."""
        refs = [self.given.description.variables[self.given.outputs[name]].ref]
        return self._read(*flat(t, x, u), refs)[:, 0].reshape(t.shape)

    def _jacobian(self, t: Times, x: States, u: Inputs) -> Jacobians:
        """Return ∂g/∂x at points along paths: the FMU's own where they are right, else central differences."""
        points = flat(t, x, u)
        slopes = self.directional(*points) if self._own_derivatives(*points) else self._by_states(*points)
        return slopes.reshape(*x.shape, x.shape[-1])

    def directional(self, t: np.ndarray, x: np.ndarray, u: np.ndarray) -> Float[np.ndarray, "n n_state n_state"]:
        """Return ∂g/∂x by the FMU; a state that feeds an input as well acts by both."""
        variables = self.given.state_columns, self.given.input_columns
        rates = [rate.ref for _, rate in self.given.dynamics if rate is not None]
        along = [[of[name].ref for of in variables if name in of] for name in self.states]

        def read(fmu: Any) -> list[float]:
            return [d for refs in along for d in (fmu.along(rates, refs) if refs else [0.0] * len(rates))]

        values = self._at(t, x, u, len(along) * len(rates), read).reshape(-1, len(along), len(rates))
        slopes = np.zeros((len(t), x.shape[-1], x.shape[-1]))
        slopes[:, self._places] = values.swapaxes(1, 2)
        return slopes

    def differences(
        self, t: np.ndarray, x: np.ndarray, u: np.ndarray, by: slice = slice(None), output: str | None = None
    ) -> Float[np.ndarray, "n ... n_by"]:
        """Differentiate rates, or an output, by t, x and u in this order, or some of them, by central differences."""
        whole, n = np.column_stack([t, x, u]), 1 + x.shape[-1]

        def values(points: np.ndarray) -> np.ndarray:
            parts = points[:, 0], points[:, 1:n], points[:, n:]
            return self._rates(*parts) if output is None else self.values_of(output, *parts)

        share = STEPPED_DIFFERENCE_STEP if self.given.stepped else CENTRAL_DIFFERENCE_STEP
        steps = np.diag(share * _sizes(whole, self._nominals))[by]
        return np.stack([(values(whole + h) - values(whole - h)) / (2 * np.max(h)) for h in steps], axis=-1)

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence if the FMU declares derivatives that are not those of its rates."""
        description = self.given.description
        if running(description).derivatives_right.get(self.given.key) is not False:
            return ()
        return (
            f"The directional derivatives of the FMU {description.name} are not those of its rates: central "
            "differences are used instead.",
        )

    def _formula(self, name: str) -> sympy.Expr:
        if name not in self._equations:
            return sympy.S.Zero
        rate = self._rate_name(name)
        return undefined(self, name) if rate is None else symbol(rate)

    def additive_terms(self, state: str) -> list[tuple[Term, float]]:
        """Return the velocity of a position; else none."""
        rate = self._rate_name(state)
        return [] if rate is None else [(Term(rate), 1.0)]

    def _rate_name(self, state: str) -> str | None:
        columns = self.given.state_columns
        declared = self.given.description.rates.get(columns[state].name) if state in columns else None
        if declared is None:
            return None
        return next((column for column, v in columns.items() if v.ref == declared.ref), None)

    @property
    def _key(self) -> Hashable:
        # No trace that calls an FMU is kept for later processes.
        return Rates(self)

    @property
    def facts(self) -> Hashable:
        """Names, and the file with what was given with it."""
        return self.states, self.inputs, repr(self.given), self.given.description

    @property
    def code(self) -> str:
        """Name, file and GUID of the FMU."""
        description = self.given.description
        return f"the FMU {description.name} ({description.file.name}, GUID {description.guid})"

    @property
    def _nominals(self) -> np.ndarray:
        """Nominal sizes of time, states and inputs."""
        variables = {**self.given.input_columns, **self.given.state_columns}
        names = (*self.states, *self.inputs)
        return np.array([1.0, *(variables[name].nominal if name in variables else 1.0 for name in names)])

    @property
    def _places(self) -> list[int]:
        return [self.states.index(name) for name in self.given.state_columns]

    def _own_derivatives(self, t: np.ndarray, x: np.ndarray, u: np.ndarray) -> bool:
        """Return True if the FMU declares derivatives, and they are those of its rates; compared once where finite."""
        given, right = self.given, running(self.given.description).derivatives_right
        if not (given.description.exchanged and given.description.directional):
            return False
        if given.key not in right:
            some = np.unique(np.linspace(0, len(t) - 1, 5).astype(int))
            part = t[some], x[some], u[some]
            by_steps = self._by_states(*part)
            compared = np.all(np.isfinite(by_steps), axis=(1, 2))
            if not compared.any():
                return False
            apart = np.abs(self.directional(*part) - by_steps)[compared].max(axis=0)
            # |dg_i/dx_j| or |g_i| / |x_j|, whichever is larger: an entry of another unit must not hide this one.
            rates = np.abs(self._rates(*part))[compared].max(axis=0)
            size = _sizes(part[1], self._nominals[1 : 1 + x.shape[-1]])
            scale = np.maximum(np.abs(by_steps)[compared].max(axis=0), rates[:, None] / size)
            right[given.key] = bool(np.all(apart <= DERIVATIVE_TOLERANCE * scale))
        return right[given.key]

    def _by_states(self, t: np.ndarray, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return self.differences(t, x, u, slice(1, 1 + x.shape[-1]))

    def _read(self, t: np.ndarray, x: np.ndarray, u: np.ndarray, refs: list[int]) -> np.ndarray:
        return self._at(t, x, u, len(refs), lambda fmu: fmu.real(refs))

    def _at(self, t: np.ndarray, x: np.ndarray, u: np.ndarray, width: int, read: Any) -> np.ndarray:
        given, columns = self.given, self.named(x.T, u.T)
        inputs = [*given.input_columns]
        fed = np.array([columns[name] for name in inputs]).reshape(len(inputs), len(t)).T
        reading = Reading(given.ports([*given.state_columns], inputs), width, read)
        points = np.asarray(t, float), x[:, self._places], fed
        return running(given.description).at_each(given.key, points, reading)


class Rates:
    """Rates of an `FMUSimulation`, or one of its outputs: equal to those of another that gives the same."""

    def __init__(self, simulation: Any, output: str | None = None) -> None:
        self.simulation, self.output, self._facts = simulation, output, (simulation.facts, output)

    def __hash__(self) -> int:
        return hash(self._facts)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Rates) and self._facts == other._facts


@lru_cache(maxsize=64)
def traced(of: Rates) -> Any:
    """Return a function of one point that JAX may trace: values by a call to the FMU, derivatives by differences."""
    simulation, output = of.simulation, of.output

    # JAX calls these with arrays of its own.
    def slopes(*point: Any) -> np.ndarray:
        t, x, u = map(np.asarray, point)
        differences = simulation.differences(*flat(t, x, u), output=output)
        return differences.reshape(*(x.shape if output is None else t.shape), differences.shape[-1])

    def values(*point: Any) -> np.ndarray:
        t, x, u = map(np.asarray, point)
        return simulation._rates(t, x, u) if output is None else simulation.values_of(output, t, x, u)

    def shape(x: Array, *more: int) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct((*(x.shape if output is None else x.shape[:-1]), *more), x.dtype)

    @jax.custom_jvp
    def rate(t: Array, x: Array, u: Array) -> Array:
        return jax.pure_callback(values, shape(x), t, x, u, vmap_method="broadcast_all")

    @rate.defjvp
    def _(point: tuple[Array, ...], along: tuple[Array, ...]) -> tuple[Array, Array]:
        t, x, u = point
        J = jax.pure_callback(slopes, shape(x, 1 + x.shape[-1] + u.shape[-1]), t, x, u, vmap_method="broadcast_all")
        return rate(t, x, u), J @ jnp.concatenate([jnp.atleast_1d(along[0]), *along[1:]])

    return rate


def _sizes(columns: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """Return the RMS of columns, or their nominal value where they are zero or a single point says too little."""
    size = np.sqrt(np.mean(columns**2, axis=0))
    if len(columns) == 1:
        size = np.maximum(size, 1e-3 * nominal)
    return np.where(size > 0, size, nominal)


def fmu_simulation(
    given: FMU, states: tuple[str, ...], inputs: tuple[str, ...], outputs: Any, units: Mapping[str, str]
) -> FMUSimulation:
    """Return the right-hand side of an FMU with the names of the data."""
    name = given.description.name
    for column, variable in given.state_columns.items():
        if column not in states:
            raise InputError(
                f"The FMU {name} has the state {variable.name!r}, and the data no state {column!r}: say which "
                f"it is, bg.FMU(..., states={{'column': {variable.name!r}}}), or use bg.TrajectoryRows(), "
                "on which states may be hidden."
            )
    for column, variable in given.input_columns.items():
        if column not in (*states, *inputs):
            raise InputError(
                f"The FMU {name} has the input {variable.name!r}, and the data have no {column!r}: say which column it "
                f"is, inputs={{'column': {variable.name!r}}}, or hold it, parameters={{{variable.name!r}: 0.0}}."
            )
    for column in given.outputs:
        if column not in outputs:
            raise InputError(f"bg.FMU(outputs=...) names {column!r}, which is no output of the data.")
    variables = {column: given.description.variables[v] for column, v in given.outputs.items()}
    require_units(name, {**given.state_columns, **given.input_columns, **variables}, units)
    return FMUSimulation(states, inputs, given)
