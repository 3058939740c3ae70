"""The rate of the whole model, simulation + dictionary + f, inside an integrator."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import sympy
from jaxtyping import Array, Float

from bayes_greybox.model.frame import Frame, held_features
from bayes_greybox.physics.formula.expressions import evaluate
from bayes_greybox.physics.formula.numbers import as_columns, without_numbers
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.running.arrays import on_device

from .posterior import Learned


class Numbers(NamedTuple):
    """Numbers in the frame of a learned state that depend on the data.

    The projection is that of the features on the terms, zero if none is subtracted; `within` are numbers within the
    formulas, such as the width of a dead zone or of a smoothed jump.
    """

    target: Float[Array, ""]
    terms: Float[Array, " n_term"]
    centre: Float[Array, " n_var"]
    half_width: Float[Array, " n_var"]
    projection: Float[Array, "n_term n_basis"]
    within: tuple[Float[Array, ""], ...]


class WholeRate:
    """dx/dt = g(x, u, p) + e_k (Φ(x, u) θ_k + Ψ̃(x, u) w_k), summed over the learned states k, with smoothed jumps.

    Parameters p that are learned stand in g itself, and not in its tangent. The columns of states and inputs set the
    width of smoothed jumps.

    Two rates with the same formulas are equal, whatever the data of their frames: `numbers` are an argument of the
    rate, so that a program compiled for one serves the other.
    """

    def __init__(
        self, simulation: Simulation, frames: Mapping[str, Frame], columns: Mapping[str, Float[np.ndarray, " n"]]
    ) -> None:
        self._simulation = simulation.rounded(columns)
        self._frames, self._formulas, self._named = dict(frames), {}, {}
        self.numbers: dict[str, Numbers] = {}
        formulas = []
        for name, frame in frames.items():
            terms = frame.dictionary.rounded(columns).terms
            if named := {k: term.parameter for k, term in enumerate(terms) if term.parameter}:
                self._named[name] = named, self._simulation.in_parameters(name, [*named.values()])
            self._formulas[name], within = without_numbers(term.expr for term in terms)
            n_basis = 0 if frame.basis is None else frame.basis.size
            projection = frame.orthonormal @ frame.moments if frame.projected else np.zeros((len(terms), n_basis))
            scales = (frame.target_scale, frame.term_scale, frame.centre, frame.half_width, projection)
            self.numbers[name] = Numbers(*on_device(scales), within=on_device(tuple(within)))
            formulas.append((name, tuple(map(sympy.srepr, self._formulas[name])), frame.variables, frame.basis))
        named = tuple((name, tuple(each.items()), sympy.srepr(g)) for name, (each, g) in self._named.items())
        self.key = (self._simulation.key, tuple(formulas), named)

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, WholeRate) and self.key == other.key

    def __call__(
        self, t: Array, x: Array, u: Array, args: tuple[Mapping[str, Numbers], Mapping[str, tuple[Array, Array]]]
    ) -> Array:
        """Return the rates of all states at time t, states x [n_state] and inputs u [n_input].

        `args` are the numbers, and the scaled (θ, weights of f), by learned state.
        """
        numbers, parameters = args
        states, inputs = self._simulation.states, self._simulation.inputs
        # Scalars throughout: an integrator's step is one loop of them, which arrays would break up.
        rate = list(self._simulation.rate(t, x, u))
        columns = dict(zip((*states, *inputs), (*x, *u), strict=True))
        for name, (theta, weight) in parameters.items():
            scale, frame = numbers[name], self._frames[name]
            values = {**columns, **as_columns(scale.within)}
            Phi = jnp.stack([evaluate(formula, values) for formula in self._formulas[name]], axis=-1) / scale.terms
            k = states.index(name)
            named, g = self._named.get(name, ({}, None))
            if g is not None:
                own = {p: theta[j] * scale.target / scale.terms[j] for j, p in named.items()}
                rate[k] = evaluate(g, {**columns, **own})
            force = sum((Phi[j] * theta[j] for j in range(len(theta)) if j not in named), jnp.zeros(()))
            if frame.basis is not None:
                position = (jnp.stack([columns[each] for each in frame.variables]) - scale.centre) / scale.half_width
                # ψ̃ = ψ − Φₒ ⟨Φₒ, ψᵀ⟩
                force = force + (held_features(frame.basis, position[None])[0] - Phi @ scale.projection) @ weight
            rate[k] = rate[k] + scale.target * force
        return jnp.stack(rate)


@dataclass(frozen=True)
class RateOfFit:
    """The rate of a fit: (t, x, u, scaled (θ, weights of f) by learned state) -> dx/dt."""

    rate: WholeRate

    def __call__(self, t: Array, x: Array, u: Array, parameters: Mapping[str, tuple[Array, Array]]) -> Array:
        """Return the rates of all states; see `WholeRate`."""
        return self.rate(t, x, u, (self.rate.numbers, parameters))

    @property
    def identity(self) -> Any:
        """Key of programs that contain this rate, for `traces.kept`."""
        return self.rate.key, jax.tree.map(np.asarray, self.rate.numbers)


def whole_rate(
    simulation: Simulation, learned: Mapping[str, Learned], columns: Mapping[str, Float[np.ndarray, " n"]]
) -> RateOfFit:
    """Return the rate of a fit; see `WholeRate` for the arguments."""
    return RateOfFit(WholeRate(simulation, {name: each.frame for name, each in learned.items()}, columns))
