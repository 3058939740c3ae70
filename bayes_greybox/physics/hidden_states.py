"""Hidden states of a formula, such as the displacement of a hysteretic element, and their values along known paths.

A formula with memory is a function of the states and of hidden ones, ż = r(x, u, z), which nobody measures. Along a
known path, z follows from its rate alone. Hidden states are integrated by the method of Runge and Kutta of order four.
Halfway between nodes, columns are those of the cubic through four neighbours. Between two nodes there are enough steps
that no change of z is missed by much.
"""

from collections.abc import Mapping, Sequence
from dataclasses import InitVar, dataclass, field
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import sympy
from jaxtyping import Array, Bool, Float

from bayes_greybox.physics.formula.expressions import evaluate, parse_expression, symbol_names
from bayes_greybox.physics.formula.grammar import check_name
from bayes_greybox.physics.formula.numbers import Named, as_columns, without_numbers
from bayes_greybox.running.compiling import compiled
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.limits import is_finite

Arrays = Array | np.ndarray
"""Arrays of JAX, or of NumPy on their way to it."""

Starts = Mapping[str, float | str]
"""Values of hidden states where a run starts: numbers, or columns that have the value there; "": at rest, at 0."""

STEP_OVER_TIME_SCALE = 0.2
"""Length of a step of hidden states, over the shortest time in which they change."""

FEWEST_STEPS_BETWEEN_NODES, MOST_STEPS_BETWEEN_NODES = 4, 256
"""Bounds on the steps between two nodes: within one of them a motion may turn round, where a rate has a kink."""

FEWEST_SYSTEMS, MANY_SYSTEMS = 8, 32
"""Programs are compiled for powers of two of systems from the first number on, and for multiples of the second."""

PROGRAM_STEPS = 4096
"""Steps of a program: longer paths are followed in stretches, so that one program serves paths of any length."""


@dataclass(frozen=True)
class HiddenState:
    """A state that no sensor shows.

    Attributes:
        name: Its name in formulas.
        rate: Formula of its rate, over columns (of an effect of the catalogue: roles) and hidden states.
        unit_of: Column, or role, whose unit and approximate size it has.
        meaning: A few words that describe it.
        start: Column, or role, whose value it has where a run starts, for a part that moves along with a body; "": at
            rest.
        rest: Its value at rest.
        named: The same rate, if it was parsed before, with names for numbers in it.
    """

    name: str
    rate: str
    unit_of: str
    meaning: str = ""
    start: str = ""
    rest: float = 0.0
    named: InitVar[Named | None] = None
    _named: Named | None = field(init=False, repr=False, compare=False)

    def __post_init__(self, named: Named | None) -> None:
        """Refuse a name or a rate that formulas cannot have."""
        check_name(self.name)
        if named is None:
            parse_expression(self.rate)
        object.__setattr__(self, "_named", named)

    @property
    def symbols(self) -> tuple[str, ...]:
        """Names in its rate, sorted."""
        return symbol_names(parse_expression(self.rate))


def read_starts(given: Any) -> dict[str, float | str]:
    """Return the starts of hidden states as the user gave them, numbers or names of columns or parameters."""
    if not isinstance(given, Mapping):
        raise InputError("GreyBox(starts=...) must map hidden states to their values where runs start: {'soc': 1.0}.")
    for name, start in given.items():
        check_name(str(name))
        if not (is_finite(start) or isinstance(start, str) and start):
            raise InputError(
                f"The start of {name!r} must be a number, the column that has the value where a run starts, or a "
                f"parameter, not {start!r}: GreyBox(starts={{{name!r}: 1.0}})."
            )
    return {str(name): start if isinstance(start, str) else float(start) for name, start in given.items()}


def along(
    systems: Sequence[Sequence[HiddenState]], time: Float[np.ndarray, " n"],
    columns: Mapping[str, Float[np.ndarray, " n"]], fresh: Bool[np.ndarray, " n"], held: Sequence[str] = (),
) -> list[dict[str, Float[np.ndarray, " n"]]]:  # fmt: skip
    """Integrate hidden states along known paths; those whose rates differ by numbers alone go together.

    Args:
        systems: Hidden states that are integrated together.
        time: Times of the nodes, in order within a run; equal where an input leaps.
        columns: States and inputs at the nodes; that of a hidden state holds its values where runs start, in place of
            its `start`.
        fresh: True at nodes where a run starts.
        held: Columns that stay from each node to the next.

    Returns:
        Values at the nodes by name, for each system; not finite where a rate is not.
    """
    if held:
        # Each node twice: with what was held until then, and with what is held from then on.
        before = np.where(fresh, np.arange(len(time)), np.arange(-1, len(time) - 1))
        both = {name: np.repeat(x, 2) for name, x in columns.items()}
        both |= {name: np.column_stack([columns[name][before], columns[name]]).ravel() for name in held if name in both}
        twice = along(systems, np.repeat(time, 2), both, np.repeat(fresh, 2) & (np.arange(2 * len(time)) % 2 == 0))
        return [{name: path[1::2] for name, path in each.items()} for each in twice]
    alike: dict[tuple[_Rates, tuple[tuple[str, float], ...]], list[tuple[int, tuple[float, ...]]]] = {}
    for k, states in enumerate(systems):
        rates, numbers = _Rates.of(states)
        alike.setdefault((rates, tuple((state.start, state.rest) for state in states)), []).append((k, numbers))
    paths: list[dict[str, np.ndarray]] = [{} for _ in systems]
    for (rates, _), members in alike.items():
        states = systems[members[0][0]]
        starts = [columns.get(state.name, columns.get(state.start, np.full(len(time), state.rest))) for state in states]
        start = np.column_stack(starts)
        values = _integrated(rates, np.array([n for _, n in members]).T, time, columns, start, fresh)
        for place, (k, _) in enumerate(members):
            paths[k] = {name: values[i, place] for i, name in enumerate(rates.names)}
    return paths


@dataclass(frozen=True)
class _Rates:
    """Rates of hidden states with named numbers, so that formulas which differ by these alone are compiled once."""

    names: tuple[str, ...]
    formulas: tuple[sympy.Expr, ...]
    numbers: tuple[str, ...]

    @classmethod
    def of(cls, states: Sequence[HiddenState]) -> "tuple[_Rates, tuple[float, ...]]":
        named = [state._named for state in states if state._named is not None]
        # Symbols of numbers are those of one effect.
        if len(named) == len(states) and len({each.numbers for each in named}) == 1:
            formulas, numbers = tuple(each.formula for each in named), named[0].numbers
        else:
            formulas, numbers = without_numbers([parse_expression(state.rate) for state in states])
        return cls(tuple(state.name for state in states), formulas, tuple(as_columns(numbers))), numbers

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that the rates depend on."""
        used = {name for formula in self.formulas for name in symbol_names(formula)}
        return tuple(sorted(used - {*self.names, *self.numbers}))

    def __call__(self, z: Array, c: Array, numbers: Array) -> Array:
        """Rates [n_hidden] at one point."""
        values = {**dict(zip(self.columns, c, strict=True)), **dict(zip(self.names, z, strict=True))}
        values |= dict(zip(self.numbers, numbers, strict=True))
        return jnp.stack([evaluate(formula, values) + 0.0 * z[0] for formula in self.formulas])


_Intervals = tuple[Arrays, ...]
"""Intervals between nodes: length, columns at three points, starts and whether a run starts at their ends."""


def _integrated(
    rates: _Rates, numbers: np.ndarray, time: np.ndarray, columns: Mapping[str, np.ndarray], start: np.ndarray,
    fresh: np.ndarray,
) -> Float[np.ndarray, "n_hidden n_system n"]:  # fmt: skip
    n, n_system = len(time), numbers.shape[1]
    c = np.column_stack([columns[name] for name in rates.columns] or [np.zeros((n, 0))])
    h = np.where(fresh[1:], 0.0, np.diff(time))
    intervals = h, c[:-1], _halfway(h, c), c[1:], start[1:], fresh[1:]
    width = max(FEWEST_SYSTEMS, 1 << (n_system - 1).bit_length())
    width = width if n_system <= MANY_SYSTEMS else -(-n_system // MANY_SYSTEMS) * MANY_SYSTEMS
    widened = np.pad(numbers, ((0, 0), (0, width - n_system)), mode="edge")
    z = np.broadcast_to(start[0][:, None], (start.shape[1], widened.shape[1]))
    whole = np.empty((start.shape[1], n_system, n))
    whole[..., 0] = z[:, :n_system]
    for first in range(0, n - 1, PROGRAM_STEPS):
        count = min(PROGRAM_STEPS, n - 1 - first)
        parts = (np.asarray(x[first : first + count]) for x in intervals)
        filled = tuple(np.pad(x, ((0, PROGRAM_STEPS - count), *((0, 0),) * (x.ndim - 1))) for x in parts)
        path = np.asarray(_followed(rates, widened, z, count, filled))
        z = path[count - 1]
        whole[..., first + 1 : first + 1 + count] = np.moveaxis(path[:count, :, :n_system], 0, -1)
    return whole


def _halfway(h: Float[np.ndarray, " n_step"], c: Float[np.ndarray, "n n_column"]) -> Float[np.ndarray, "n_step n_c"]:
    """Interpolate columns halfway between nodes: cubics through four of them, lines where steps are not even."""
    line = (c[1:] + c[:-1]) / 2
    if len(h) < 3:
        return line
    even = np.zeros(len(h), bool)
    even[1:-1] = (np.abs(h[:-2] - h[1:-1]) < 1e-6 * h[1:-1]) & (np.abs(h[2:] - h[1:-1]) < 1e-6 * h[1:-1])
    cubic = line.copy()
    cubic[1:-1] = (9 * (c[1:-2] + c[2:-1]) - c[:-3] - c[3:]) / 16
    return np.where(even[:, None], cubic, line)


@partial(compiled, often=True, static_argnums=0)
def _followed(rates: _Rates, numbers: Arrays, z: Arrays, n_step: Arrays | int, intervals: _Intervals) -> Array:
    # As programs of their own these are traced once, for all places that they are called at.
    each = jax.jit(jax.vmap(rates, in_axes=(1, None, 1), out_axes=1))
    slopes = jax.jit(jax.vmap(jax.jacfwd(rates), in_axes=(1, None, 1)))

    def step(z: Array, interval: tuple[Array, ...]) -> Array:
        h, c0, c1, c2, start, fresh = interval
        fastest = jnp.maximum(*(jnp.max(jnp.sum(jnp.abs(slopes(z, c, numbers)), axis=-1)) for c in (c0, c2)))
        needed = jnp.ceil(jnp.nan_to_num(h * fastest / STEP_OVER_TIME_SCALE))
        count = jnp.clip(needed, FEWEST_STEPS_BETWEEN_NODES, MOST_STEPS_BETWEEN_NODES)

        def rate(z: Array, share: Array) -> Array:
            # The parabola through the nodes and the middle.
            c = (1 - share) * (1 - 2 * share) * c0 + 4 * share * (1 - share) * c1 + share * (2 * share - 1) * c2
            return each(z, c, numbers)

        def part(k: Array, z: Array) -> Array:
            length, share = h / count, k / count
            k1 = rate(z, share)
            k2 = rate(z + length / 2 * k1, share + 0.5 / count)
            k3 = rate(z + length / 2 * k2, share + 0.5 / count)
            k4 = rate(z + length * k3, share + 1 / count)
            return z + length / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

        moved = jax.lax.fori_loop(0, count.astype(int), part, z)
        return jnp.where(fresh, start[:, None], moved)

    def next_one(k: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        z, path = carry
        z = step(z, tuple(jax.lax.dynamic_index_in_dim(x, k, keepdims=False) for x in intervals))
        return z, jax.lax.dynamic_update_index_in_dim(path, z, k, 0)

    return jax.lax.fori_loop(0, n_step, next_one, (z, jnp.zeros((len(intervals[0]), *z.shape))))[1]
