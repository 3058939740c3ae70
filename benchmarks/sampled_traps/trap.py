"""Traps, and the means to make their data: drives, paths by SciPy and noise. Nothing here knows how studies work."""

from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

from bayes_greybox.data.trajectories import Trajectories

Signal = Callable[[Any], Any]
"""Values by time, of one time or of many."""

Rates = Callable[[float, Float[np.ndarray, " n_state"], float], Sequence[float]]
"""Rates of all states from time, states and drive."""

STREAM = 20240
"""Entry of the seeds that keeps the draws of traps apart from those of other benchmarks."""


@dataclass(frozen=True)
class Trap:
    """Samples that tempt to a wrong name, or, of a control, samples whose answer is clear.

    Attributes:
        name: Name of the trap.
        why: Reason why a study is tempted.
        simulation: Right-hand sides that the study is given.
        data: Function from the seed of the draws to the samples.
        equation: State whose equation may lack something.
        learned: Terms of that equation whose coefficients are learned anyway.
        hold: Course of inputs between samples, by the engineer's word.
        catalogue: Domain of the effects that are weighed.
        allowed: Slugs that it would be right or excusable to name.
        wanted: Slugs of which one must be named, of a control.
        answer: Verdict that is right without a name, of a control; None where a name must be found.
        rates: States whose rate is another one, where a filter computes rates; samples are followed where it is empty.
    """

    name: str
    why: str
    simulation: Mapping[str, str]
    data: Callable[[int], Trajectories]
    equation: str = "v"
    learned: tuple[str, ...] = ()
    hold: Literal["linear", "held"] = "linear"
    catalogue: str = "mechanical"
    allowed: AbstractSet[str] = frozenset()
    wanted: AbstractSet[str] = frozenset()
    answer: str | None = None
    rates: Mapping[str, str] = field(default_factory=dict)

    @property
    def control(self) -> bool:
        """True if the answer is clear, so that *unknown* is a failure."""
        return bool(self.wanted or self.answer)


def trap(
    number: int, simulation: Mapping[str, str], **more: Any
) -> Callable[[Callable[[np.random.Generator], Trajectories]], Trap]:
    """Make a trap of the function that draws its samples, by its name and its docstring.

    Args:
        number: Number that keeps its draws apart from those of other traps.
        simulation: Right-hand sides that the study is given.
        **more: Further attributes of `Trap`.
    """

    def made(drawn: Callable[[np.random.Generator], Trajectories]) -> Trap:
        name, why = drawn.__name__.strip("_").replace("_", "-"), " ".join((drawn.__doc__ or "").split())
        return Trap(name, why, simulation, lambda seed: drawn(generator(seed, number)), **more)

    return made


def generator(seed: int, number: int) -> np.random.Generator:
    """Return the generator of the draws of a trap."""
    return np.random.default_rng([STREAM, number, seed])


def recorded(t: Any, x: Any, u: Any = None) -> Trajectories:
    """Return samples of a state x, or of several by name, and of an input u."""
    states = x if isinstance(x, Mapping) else {"x": x}
    return Trajectories.from_arrays(t, states=states, inputs=None if u is None else {"u": u})


def multisine(rng: np.random.Generator, low: float, high: float, lines: int, rms: float) -> Signal:
    """Draw a smooth random signal: sines from about the low to the high frequency, their sum of this RMS."""
    w = np.linspace(low, high, lines) * (1 + 0.01 * rng.standard_normal(lines))
    phase = rng.uniform(0, 2 * np.pi, lines)
    a = rng.uniform(0.6, 1.4, lines)
    a *= rms / np.sqrt(0.5 * np.sum(a**2))
    return lambda t: np.sin(np.multiply.outer(t, w) + phase) @ a


def staircase(rng: np.random.Generator, end: float, step: float, sd: float) -> tuple[Signal, np.ndarray]:
    """Draw levels, each held for a step; return the times at which they change, where the next one holds already."""
    levels = sd * rng.standard_normal(int(np.ceil(end / step)) + 1)

    def value(t: Any) -> Any:
        return levels[np.clip(np.floor(np.asarray(t) / step + 1e-9).astype(int), 0, len(levels) - 1)]

    return value, step * np.arange(1, len(levels))


def path(
    rates: Rates,
    start: Sequence[float],
    t: Float[np.ndarray, " n"],
    drive: Signal | None = None,
    *,
    breaks: Sequence[float] | np.ndarray = (),
    begin: float | None = None,
) -> Float[np.ndarray, "n_state n"]:
    """Integrate the states.

    Args:
        rates: Rates of the states.
        start: States at the beginning.
        t: Times, ascending.
        drive: Signal that drives the states; None where nothing does.
        breaks: Times between which the drive is held; none where it is smooth.
        begin: Time at which the path begins; that of the first sample by default.
    """
    drive = drive or (lambda _: 0.0)

    def motion(time: float, x: np.ndarray, middle: float) -> Sequence[float]:
        # A held drive is asked for in the middle: at an edge, rounding would decide between two levels.
        return rates(time, x, float(drive(middle if len(breaks) else time)))

    accurate = {"rtol": 1e-10, "atol": 1e-12, "method": "DOP853"}
    first = t[0] if begin is None else begin
    edges = [first, *(edge for edge in breaks if first < edge < t[-1]), t[-1]]
    x, found = np.array(start, float), []
    for low, high in pairwise(edges):
        # The end of one piece is the start of the next.
        times = [*t[(t >= low) & (t < high)], high]
        piece = solve_ivp(motion, (low, high), x, t_eval=times, args=((low + high) / 2,), **accurate).y
        x = piece[:, -1]
        found.append(piece[:, :-1])
    return np.column_stack([*found, x])


def noisy(
    rng: np.random.Generator, x: Float[np.ndarray, " n"], share: float, clean: Float[np.ndarray, " n"] | None = None
) -> Float[np.ndarray, " n"]:
    """Add white noise, whose standard deviation is a share of the spread of the clean signal, by default x itself."""
    return x + share * np.std(x if clean is None else clean) * rng.standard_normal(len(x))
