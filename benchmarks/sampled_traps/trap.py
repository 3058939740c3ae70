"""What a trap is, and what its data are made with: drives, paths by SciPy and noise. Nothing knows how studies work."""

from collections.abc import Callable, Mapping, Sequence
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
"""Of all states, from time, states and what drives them."""

STREAM = 20240
"""The draws of traps are nobody else's."""


@dataclass(frozen=True)
class Trap:
    """Samples that tempt to a wrong name, or, of a control, samples whose answer is clear.

    Attributes:
        name: Of the trap.
        why: What tempts.
        simulation: What the study is given.
        equation: The state whose equation may lack something.
        data: Samples by the seed of their draws.
        learned: Terms of that equation whose coefficients are learned anyway.
        hold: What inputs do between samples, as the engineer says.
        catalogue: Domain of the effects that are weighed.
        control: Whether the answer is clear, so that *unknown* is a failure.
        allowed: Slugs that it would be right or excusable to name.
        wanted: Of a control, slugs of which one must be named.
        answer: Of a control, the verdict that is right without a name; None where a name must be found.
        rates: States whose rate is another one, where a filter computes rates; samples are followed where it is empty.
    """

    name: str
    why: str
    simulation: Mapping[str, str]
    equation: str
    data: Callable[[int], Trajectories]
    learned: tuple[str, ...] = ()
    hold: Literal["linear", "held"] = "linear"
    catalogue: str = "mechanical"
    control: bool = False
    allowed: frozenset[str] = frozenset()
    wanted: frozenset[str] = frozenset()
    answer: str | None = None
    rates: Mapping[str, str] = field(default_factory=dict)


def generator(seed: int, number: int) -> np.random.Generator:
    """The draws of one trap.

    Args:
        seed: Of all traps.
        number: Of the trap.
    """
    return np.random.default_rng([STREAM, number, seed])


def multisine(rng: np.random.Generator, low: float, high: float, lines: int, rms: float) -> Signal:
    """A smooth random signal.

    Args:
        rng: Of its lines.
        low: Frequency of the first line, about.
        high: Frequency of the last one.
        lines: Number of sines.
        rms: Of their sum.
    """
    w = np.linspace(low, high, lines) * (1 + 0.01 * rng.standard_normal(lines))
    phase = rng.uniform(0, 2 * np.pi, lines)
    a = rng.uniform(0.6, 1.4, lines)
    a *= rms / np.sqrt(0.5 * np.sum(a**2))
    return lambda t: np.sin(np.multiply.outer(t, w) + phase) @ a


def staircase(rng: np.random.Generator, end: float, step: float, sd: float) -> tuple[Signal, np.ndarray]:
    """Random levels, each held for a while, and the times at which they change; there the next one holds already.

    Args:
        rng: Of the levels.
        end: Time up to which there are levels.
        step: Time for which each is held.
        sd: Of the levels.
    """
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
    """States at the times.

    Args:
        rates: Of the states.
        start: States at the beginning.
        t: Times, ascending.
        drive: What drives the states; None where nothing does.
        breaks: Times between which the drive is held; none where it is smooth.
        begin: The time at which the path begins; that of the first sample by default.
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
        own = [*t[(t >= low) & (t < high)], high]
        piece = solve_ivp(motion, (low, high), x, t_eval=own, args=((low + high) / 2,), **accurate).y
        x = piece[:, -1]
        found.append(piece[:, :-1])
    return np.column_stack([*found, x])


def noisy(
    rng: np.random.Generator, x: Float[np.ndarray, " n"], share: float, clean: Float[np.ndarray, " n"] | None = None
) -> Float[np.ndarray, " n"]:
    """Samples with white noise.

    Args:
        rng: Of the noise.
        x: Samples without it.
        share: Standard deviation of the noise over the spread of the signal.
        clean: The signal; the samples by default.
    """
    return x + share * np.std(x if clean is None else clean) * rng.standard_normal(len(x))
