"""The right-hand side that an FMU is."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import sympy
from jaxtyping import Array, Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.formula.grammar import symbol
from bayes_greybox.physics.simulation.protocol import Simulation, finite
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError

from .given import FMU
from .running import running
from .tracing import Rates, flat, traced

DIFFERENCE = 6e-6
"""Step of central differences over the size of a column: the cube root of rounding."""

LONG = 1e-3
"""The same where rates are differences themselves, whose errors a shorter one would show."""

FLOOR = 1e-3
"""Share of its nominal value that a column has at least where one point says how large it is."""

VERIFIED = 5
"""Points at which directional derivatives are compared with differences before they are used."""

AGREE = 1e-4
"""Share of an entry's size, or of its rate over the size of its state, by which they may differ."""


@dataclass(frozen=True)
class FMUSimulation(Simulation):
    """An FMU as a simulation: states that it does not have stand still.

    Attributes:
        given: The FMU.
    """

    given: FMU

    @property
    def differentiable(self) -> bool:
        """No: it has first derivatives, and no trace."""
        return False

    @property
    def equations(self) -> tuple[str, ...]:
        """Its states, and outputs that it was asked for."""
        return (*self.given.state_columns, *self.given.outputs)

    def rate(self, t: Array, x: Float[Array, " n_state"], u: Float[Array, " n_input"]) -> Float[Array, " n_state"]:
        """Value of g at one point, by a call from JAX to the FMU; many points at once are one call."""
        return traced(Rates(self))(jnp.asarray(t, float), jnp.asarray(x, float), jnp.asarray(u, float))

    def on(self, data: Trajectories, state: str) -> Float[np.ndarray, " n_obs"]:
        """Values of g for one state or output on the rows of the data, user's units."""
        t, x, u = data.time, data.matrix(self.states), data.matrix(self.inputs)
        if state in self.given.outputs:
            found = self.values_of(state, t, x, u)
        elif state in self.given.state_columns:
            found = self.rates(t, x, u)[:, self.states.index(state)]
        else:
            return np.zeros(data.n_obs)
        said = [*running(self.given.description).said]
        if said and not np.all(np.isfinite(found)):
            raise InputError(f"The FMU {self.given.description.name} refuses some of the data: {said[-1]}.")
        return finite(found, state)

    def rates(
        self, t: Float[np.ndarray, "*n"], x: Float[np.ndarray, "*n n_state"], u: Float[np.ndarray, "*n n_input"]
    ) -> Float[np.ndarray, "*n n_state"]:
        """Values of g at many points, NaN where the FMU refuses one."""
        points = flat(t, x, u)
        found = np.zeros(points[1].shape)
        known = self.given.dynamics
        refs = [rate.ref for _, rate in known if rate is not None]
        if len(refs) == len(known):
            found[:, self._places] = self._read(*points, refs)
        else:
            states = [state.ref for state, _ in known]
            found[:, self._places] = self._at(*points, len(states), lambda fmu: fmu.stepped(states))
        return found.reshape(x.shape)

    def output(self, name: str, t: Any, x: Any, u: Any) -> Any:
        """Values of an output at many points, zero if it is none of the FMU's."""
        if name not in self.given.outputs:
            return super().output(name, t, x, u)
        if isinstance(x, np.ndarray):
            return self.values_of(name, t, x, u)
        return jax.vmap(traced(Rates(self, name)))(t, x, u)

    def values_of(
        self,
        name: str,
        t: Float[np.ndarray, "*n"],
        x: Float[np.ndarray, "*n n_state"],
        u: Float[np.ndarray, "*n n_input"],
    ) -> Float[np.ndarray, "*n"]:
        """Values of an output at many points, NaN where the FMU refuses one."""
        refs = [self.given.description.variables[self.given.outputs[name]].ref]
        return self._read(*flat(t, x, u), refs)[:, 0].reshape(t.shape)

    def jacobian(
        self, t: Float[np.ndarray, "*n"], x: Float[np.ndarray, "*n n_state"], u: Float[np.ndarray, "*n n_input"]
    ) -> Float[np.ndarray, "*n n_state n_state"]:
        """∂g/∂x at points along paths: the FMU's own where it gives them rightly, else central differences."""
        points = flat(t, x, u)
        found = self.directional(*points) if self._own_derivatives(*points) else self._by_states(*points)
        return found.reshape(*x.shape, x.shape[-1])

    def directional(self, t: np.ndarray, x: np.ndarray, u: np.ndarray) -> Float[np.ndarray, "n n_state n_state"]:
        """∂g/∂x by the FMU; a state that feeds an input as well acts by both."""
        known, fed = self.given.state_columns, self.given.input_columns
        rates = [rate.ref for _, rate in self.given.dynamics if rate is not None]
        along = [[of[name].ref for of in (known, fed) if name in of] for name in self.states]

        def read(fmu: Any) -> list[float]:
            return [d for refs in along for d in (fmu.along(rates, refs) if refs else [0.0] * len(rates))]

        own = self._at(t, x, u, len(along) * len(rates), read).reshape(-1, len(along), len(rates))
        found = np.zeros((len(t), x.shape[-1], x.shape[-1]))
        found[:, self._places] = own.swapaxes(1, 2)
        return found

    def differences(
        self, t: np.ndarray, x: np.ndarray, u: np.ndarray, by: slice = slice(None), output: str | None = None
    ) -> Float[np.ndarray, "n ... n_by"]:
        """Derivatives of rates by t, x and u, in this order, by central differences.

        Args:
            t: Times.
            x: States.
            u: Inputs.
            by: By which of them.
            output: Of which output, in the place of rates.
        """
        whole, n = np.column_stack([t, x, u]), 1 + x.shape[-1]

        def values(point: np.ndarray) -> np.ndarray:
            given = point[:, 0], point[:, 1:n], point[:, n:]
            return self.rates(*given) if output is None else self.values_of(output, *given)

        share = LONG if self.given.stepped else DIFFERENCE
        steps = np.diag(share * _sizes(whole, self._nominals))[by]
        both = [(values(whole + h) - values(whole - h)) / (2 * np.max(h)) for h in steps]
        return np.stack(both, axis=-1)

    @property
    def warnings(self) -> tuple[str, ...]:
        """That the FMU declares derivatives which are not those of its rates."""
        found = self.given.description
        if running(found).right(self.given.parameters) is not False:
            return ()
        return (
            f"The directional derivatives of the FMU {found.name} are not those of its rates: central differences are "
            "used instead.",
        )

    def formula(self, name: str) -> sympy.Expr:
        """The velocity of a position; else an undefined function g_name(t, x, u): code cannot be read."""
        if name not in self.equations:
            return sympy.S.Zero
        rate = self.rate_name(name)
        if rate is not None:
            return symbol(rate)
        return sympy.Function(f"g_{name}", real=True)(*map(symbol, ("t", *self.states, *self.inputs)))

    def additive_terms(self, state: str) -> list[tuple[Term, float]]:
        """The velocity of a position; else none."""
        rate = self.rate_name(state)
        return [] if rate is None else [(Term(rate), 1.0)]

    def rate_name(self, state: str) -> str | None:
        """The state that the FMU declares to be the rate of a state."""
        own = self.given.state_columns
        declared = self.given.description.rates.get(own[state].name) if state in own else None
        if declared is None:
            return None
        return next((column for column, v in own.items() if v.ref == declared.ref), None)

    @property
    def key(self) -> Hashable:
        """Names, and the file with what was given with it; no trace that calls it is kept for later processes."""
        return Rates(self)

    @property
    def facts(self) -> Hashable:
        """Names, and the file with what was given with it."""
        return self.states, self.inputs, repr(self.given), self.given.description

    @property
    def code(self) -> str:
        """Which FMU it is."""
        found = self.given.description
        return f"the FMU {found.name} ({found.file.name}, GUID {found.guid})"

    @property
    def _nominals(self) -> np.ndarray:
        """Usual sizes of time, states and inputs."""
        known = {**self.given.input_columns, **self.given.state_columns}
        return np.array(
            [1.0, *(known[name].nominal if name in known else 1.0 for name in (*self.states, *self.inputs))]
        )

    @property
    def _places(self) -> list[int]:
        return [self.states.index(name) for name in self.given.state_columns]

    def _own_derivatives(self, t: np.ndarray, x: np.ndarray, u: np.ndarray) -> bool:
        """Whether the FMU declares derivatives, and they are those of its rates; looked at once where it has some."""
        given, instance = self.given, running(self.given.description)
        if not (given.description.exchanged and given.description.interface.directional):
            return False
        if instance.right(given.parameters) is None:
            some = np.unique(np.linspace(0, len(t) - 1, VERIFIED).astype(int))
            part = t[some], x[some], u[some]
            by_steps = self._by_states(*part)
            asked = np.all(np.isfinite(by_steps), axis=(1, 2))
            if not asked.any():
                return False
            apart = np.abs(self.directional(*part) - by_steps)[asked].max(axis=0)
            # |dg_i/dx_j| or |g_i| / |x_j|, whichever is larger: an entry of another unit must not hide this one.
            rates, size = (
                np.abs(self.rates(*part))[asked].max(axis=0),
                _sizes(part[1], self._nominals[1 : 1 + x.shape[-1]]),
            )
            scale = np.maximum(np.abs(by_steps)[asked].max(axis=0), rates[:, None] / size)
            instance.found_right(given.parameters, bool(np.all(apart <= AGREE * scale)))
        return bool(instance.right(given.parameters))

    def _by_states(self, t: np.ndarray, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return self.differences(t, x, u, slice(1, 1 + x.shape[-1]))

    def _read(self, t: np.ndarray, x: np.ndarray, u: np.ndarray, refs: list[int]) -> np.ndarray:
        return self._at(t, x, u, len(refs), lambda fmu: fmu.real(refs))

    def _at(self, t: np.ndarray, x: np.ndarray, u: np.ndarray, width: int, read: Any) -> np.ndarray:
        given = self.given
        columns = dict(zip((*self.states, *self.inputs), (*x.T, *u.T), strict=True))
        inputs = [*given.input_columns]
        fed = [columns[name] for name in inputs]
        points = np.asarray(t, float), x[:, self._places], np.array(fed).reshape(len(fed), len(t)).T
        ports = given.ports([*given.state_columns], inputs)
        return running(given.description).at_each(given.parameters, points, ports, width, read)


def _sizes(columns: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """RMS of columns, their nominal value where they are zero; a single point is not taken to say how small one is."""
    size = np.sqrt(np.mean(columns**2, axis=0))
    if len(columns) == 1:
        size = np.maximum(size, FLOOR * nominal)
    return np.where(size > 0, size, nominal)


def fmu_simulation(
    given: FMU, states: tuple[str, ...], inputs: tuple[str, ...], outputs: Any, units: Mapping[str, str]
) -> FMUSimulation:
    """The right-hand side of an FMU with the names of the data.

    Raises:
        InputError: A state or an input of the FMU without a column; an output that the data lack; other units.
    """
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
    from .units import require_units

    variables = {column: given.description.variables[v] for column, v in given.outputs.items()}
    require_units(name, {**given.state_columns, **given.input_columns, **variables}, units)
    return FMUSimulation(states, inputs, given)
