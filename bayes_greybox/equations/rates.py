"""The right-hand side of learned equations as a function, on NumPy's arrays or on JAX's."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.physics.units import target_unit
from bayes_greybox.running.errors import InputError

from .learned import Drawn, Features, LearnedEquation, LearnedSystem

BACKENDS: Mapping[str, ModuleType] = {"numpy": np, "jax": jnp}
"""Array packages by name."""


@dataclass(frozen=True, eq=False)
class LearnedRates:
    """(t, x, u) -> the rate of every state, as `GreyBox(simulation=...)` takes a function; made by `learned_rates`.

    Jumps such as sign(v) are exact; an integrator needs short steps there, or an event.

    Attributes:
        states: Names of x, in order; units as in the data.
        inputs: Names of u, in order; units as in the data.
        equations: Names of the returned quantities, in order: the states that have an equation, then outputs. If every
            state has one and there are no outputs these are the states.
        units: Units of the returned quantities, by name; "" if unknown.
        n_draw: Number of posterior draws, along the first axis of the result; None: one model, and no such axis.
        added: Draws, and features of f, that are added to the simulation, by equation.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    equations: tuple[str, ...]
    units: Mapping[str, str]
    n_draw: int | None
    simulation: Simulation
    added: Mapping[str, tuple[Drawn, Features | None]]
    backend: str

    def __call__(self, t: Any, x: Any, u: Any = None) -> Any:
        """Return the rates at one point or at many.

        Args:
            t: Time, a number or an array `[*n]`; only a simulation that is code may use it.
            x: States `[*n, n_state]`.
            u: Inputs `[*n, n_input]`; None for a model without inputs.

        Returns:
            Rates `[*n, n_equation]`, or `[n_draw, *n, n_equation]` of posterior draws.

        Raises:
            InputError: The numbers of states or inputs are not those of the model.
        """
        xp = BACKENDS[self.backend]
        x = xp.asarray(x, float)
        u = xp.zeros((*x.shape[:-1], 0)) if u is None else xp.asarray(u, float)
        for values, names, what in ((x, self.states, "states"), (u, self.inputs, "inputs")):
            if values.ndim == 0 or values.shape[-1] != len(names):
                has = values.shape[-1] if values.ndim else "a single number"
                raise InputError(
                    f"The last axis of the {what} must have {len(names)} values ({', '.join(names) or 'none'}), not "
                    f"{has}: call rates(t, x, u)."
                )
        shape = np.broadcast_shapes(np.shape(t), x.shape[:-1], u.shape[:-1])
        n = math.prod(shape)
        rows = self._rows(
            xp.broadcast_to(xp.asarray(t, float), shape).reshape(n),
            xp.broadcast_to(x, (*shape, x.shape[-1])).reshape(n, x.shape[-1]),
            xp.broadcast_to(u, (*shape, u.shape[-1])).reshape(n, u.shape[-1]),
        )
        rates = rows.reshape(self.n_draw or 1, *shape, len(self.equations))
        return rates[0] if self.n_draw is None else rates

    def draw(self, k: int) -> "LearnedRates":
        """Return the right-hand side of one posterior draw alone.

        Args:
            k: Number of the draw, from 0 on.

        Raises:
            InputError: There is no such draw.
        """
        if self.n_draw is None or not 0 <= k < self.n_draw:
            raise InputError(f"There is no draw {k}: ask for draws, to_callable(draws=...), and count them from 0.")
        added = {
            name: (replace(drawn, coefficients=drawn.coefficients[[k]], weights=drawn.weights[[k]]), features)
            for name, (drawn, features) in self.added.items()
        }
        return replace(self, n_draw=None, added=added)

    def _rows(self, t: Any, x: Any, u: Any) -> Any:
        """Return the rates [n_draw, n, n_equation] at rows."""
        xp = BACKENDS[self.backend]
        columns = {name: x[:, i] for i, name in enumerate(self.states)}
        columns |= {name: u[:, i] for i, name in enumerate(self.inputs)}
        each = self.simulation.rates if xp is np else jax.vmap(self.simulation.rate)
        simulated = each(t, x, u) if self.states else x
        rates = []
        for name in self.equations:
            if name in self.states:
                rate = simulated[:, self.states.index(name)]
            else:
                rate = self.simulation.output(name, t, x, u)
            rate = xp.broadcast_to(rate, (self.n_draw or 1, len(t)))
            drawn, features = self.added.get(name, (None, None))
            if drawn is not None and drawn.terms:
                # Σ_j θ_j φ_j(x, u)
                Phi = xp.stack([term.evaluate(columns) for term in drawn.terms], axis=-1)
                rate = rate + xp.asarray(drawn.coefficients) @ Phi.T
            if drawn is not None and features is not None:
                # f(x) = Ψ̃(x) w
                rate = rate + xp.asarray(drawn.weights) @ features(columns).T
            rates.append(rate)
        return xp.stack(rates, axis=-1)


def learned_rates(
    system: LearnedSystem, backend: str = "numpy", draws: int | None = None, discrepancy: bool = False
) -> LearnedRates:
    """Return the right-hand side of a system of learned equations; see `Fit.to_callable` for the arguments.

    Raises:
        InputError: An unknown backend, an impossible number of draws, or a request for f without finite expansion.
    """
    if backend not in BACKENDS:
        raise InputError(f"backend={backend!r} is not known: use {' or '.join(map(repr, BACKENDS))}.")
    most = min((len(each.drawn.coefficients) for each in system.learned.values()), default=0)
    if draws is not None and not 1 <= draws <= most:
        raise InputError(f"draws={draws} must lie between 1 and {most}, the number of posterior draws.")
    for name, each in system.learned.items():
        if discrepancy and each.discrepancy is not None and each.discrepancy.features is None:
            raise InputError(
                f"The discrepancy of {name!r} has no finite expansion: fit with OrthogonalGP(path='hsgp'), or leave "
                "out discrepancy=True."
            )
    units = {name: target_unit(name, system.data) for name in system.names}
    added = {name: _added(each, draws, discrepancy) for name, each in system.learned.items()}
    return LearnedRates(system.states, system.inputs, system.names, units, draws, system.simulation, added, backend)


def _added(equation: LearnedEquation, draws: int | None, with_f: bool) -> tuple[Drawn, Features | None]:
    f, drawn = equation.discrepancy if with_f else None, equation.drawn
    if draws is None:
        mean = np.array([[each.value.mean for each in equation.terms]])
        weights = np.zeros((1, 0)) if f is None else f.mean[None]
        drawn = Drawn(tuple(each.term for each in equation.terms), mean, weights)
    else:
        pick = np.linspace(0, len(drawn.coefficients) - 1, draws).round().astype(int)
        drawn = replace(drawn, coefficients=drawn.coefficients[pick], weights=drawn.weights[pick])
    return drawn, None if f is None else f.features
