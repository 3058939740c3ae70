"""Integration of dx/dt = rhs(t, x, u) with adaptive steps, for free runs: a blow-up is a result, not an error."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.interpolate import CubicSpline

from bayes_greybox.physics.formula.expressions import namespace
from bayes_greybox.running.errors import InputError

from .solvers import diffrax, ordered_times

INTERPOLATIONS = ("linear", "zoh", "cubic")
"""Interpolations of an input between its samples; "zoh" is a zero-order hold."""

PIECE = 128
"""Rows that are integrated in one go."""

BLOW_UP = 1e12
"""Size at which a run has failed, over the largest size of a state."""


class Samples(NamedTuple):
    """Samples of a run or of its pieces: times, inputs at them, and second derivatives of the inputs' splines."""

    times: Float[Array | np.ndarray, "*piece n"]
    values: Float[Array | np.ndarray, "*piece n p"]
    curvature: Float[Array | np.ndarray, "*piece n p"]


class Limits(NamedTuple):
    """Start, end and duration of a run, typical sizes of its states, and the size beyond which the run has failed."""

    x0: Float[Array | np.ndarray, "*draw d"]
    end: Float[Array, ""]
    span: Float[Array, ""]
    sizes: Float[Array | np.ndarray, " d"]
    limit: Float[Array, ""]


class StepSettings(NamedTuple):
    """Settings of the integrator.

    Attributes:
        rtol: Relative tolerance.
        atol: Absolute tolerance, as a share of the states' sizes.
        max_steps: Steps allowed for a piece; equations that need more are stiff, and the run has failed.
        solver: Diffrax solver; by default Dormand and Prince's method of order 8.
        adjoint: Diffrax adjoint; by default derivatives are taken backwards.
    """

    rtol: Float[Array, ""] | float = 1e-8
    atol: Float[Array, ""] | float = 1e-8
    max_steps: int = 32 * PIECE
    solver: Any = None
    adjoint: Any = None


def check_interpolation(kind: str | Sequence[str]) -> None:
    """Refuse interpolations, of all inputs or of each, that are not among `INTERPOLATIONS`."""
    for unknown in {kind} if isinstance(kind, str) else {str(each) for each in kind}:
        if unknown not in INTERPOLATIONS:
            raise InputError(f"Unknown interpolation {unknown!r}; use 'linear', 'zoh' or 'cubic'.")


def cut(
    t: Float[Array | np.ndarray, " n"], inputs: Float[Array | np.ndarray, "n p"], interpolation: str | Sequence[str],
    curvature: Float[Array | np.ndarray, "n p"] | None = None,
) -> tuple[Samples, tuple[str, ...]]:  # fmt: skip
    """Cut a run into pieces of one size: a loop of many lanes copies all rows that it reads or saves at every step.

    Inputs at the increasing times t are interpolated by "linear", "zoh" (held from each sample to the next) or "cubic"
    (twice differentiable spline), all alike or each by its own. Second derivatives of splines through a longer record
    may be given as `curvature`.

    Returns:
        Pieces along a first axis, and the interpolation of each input.
    """
    if t.shape[0] < 2:
        raise InputError(f"Integration needs at least two times, not {t.shape[0]}; give a longer window.")
    if inputs.shape[0] != t.shape[0]:
        raise InputError(f"The inputs have {inputs.shape[0]} rows for {t.shape[0]} times; give one row for each time.")
    xp = namespace([t, inputs])
    values = xp.asarray(inputs, dtype=float)
    if curvature is None:
        kinds, curvature = curvature_of(t, values, interpolation)
    else:
        kinds = one_for_each(interpolation, values.shape[1])
    piece = min(PIECE, t.shape[0] - 1)
    n_piece = -(-(t.shape[0] - 1) // piece)
    beyond = t[-1] + (t[-1] - t[-2]) * np.arange(1, n_piece * piece + 2 - t.shape[0])
    rows = np.arange(n_piece)[:, None] * piece + np.arange(piece + 1)
    measured_rows = np.minimum(rows, t.shape[0] - 1)
    times = xp.concatenate([t, beyond])[rows]
    return Samples(times, values[measured_rows], xp.asarray(curvature)[measured_rows]), kinds


def limits_of(
    t: Float[Array | np.ndarray, " n"], x0: Float[Array | np.ndarray, "*draw d"], sizes: Float[Array | np.ndarray, " d"]
) -> Limits:
    """Return the limits of a run from x0 at t[0], which fails at `BLOW_UP` times the largest size of a state."""
    return Limits(x0, t[-1], t[-1] - t[0], sizes, BLOW_UP * namespace([sizes]).max(sizes))


def follow_piece(
    rhs: Callable[[Any, Any, Any, Any], Any], start: tuple[Float[Array, " d"], Array], samples: Samples, limits: Limits,
    args: Any, kinds: tuple[str, ...], settings: StepSettings | None = None,
) -> tuple[tuple[Float[Array, " d"], Array], tuple[Float[Array, "rows d"], Float[Array, ""], Array]]:  # fmt: skip
    """Integrate over one piece; a program compiled for it serves runs of any length, and works under jit and vmap.

    Steps are adaptive and never step over a sample of the inputs. The default method is explicit, so a stiff system
    spends its steps and needs an implicit one. The local error of state i is kept below
    atol * scale_i + rtol * |x_i|.

    Args:
        rhs: `rhs(t, x, u, args)`, which returns dx/dt; p = 0 without inputs.
        start: States at the start of the piece, and whether the run has not failed before.
        samples: The piece.
        limits: Limits of the run.
        args: Last argument of `rhs`, for example a posterior draw of the coefficients.
        kinds: Interpolation of each input.
        settings: Settings of the integrator.

    Returns:
        The start of the next piece; states at all but the first of the times, the time of a failure or NaN, and whether
        steps ran out.
    """
    x0, settings = limits.x0, settings or StepSettings()
    (_, alive), times = start, samples.times
    solution = _solution(rhs, start, samples, limits, args, kinds, settings)
    (states, _), (_, (stopped_at,)) = cast(Any, solution.ys), cast(Any, solution.ts)
    results = diffrax().RESULTS
    reached = solution.result == results.successful
    good = alive & (reached | (times <= stopped_at)) & jnp.all(jnp.isfinite(states), axis=-1)
    # Once a row is lost, all later ones are; a lost run stands still at its start.
    good = jnp.cumprod(good.astype(int)).astype(bool)
    last = (jnp.where(good[-1], states[-1], x0), good[-1])
    failed_at = jnp.where(reached | ~alive, jnp.nan, stopped_at)
    exhausted = alive & (solution.result == results.max_steps_reached)
    return last, (jnp.where(good[1:, None], states[1:], jnp.nan), failed_at, exhausted)


def _solution(
    rhs: Callable[[Any, Any, Any, Any], Any], start: tuple[Array, Array], samples: Samples, limits: Limits, args: Any,
    kinds: tuple[str, ...], settings: StepSettings,
) -> Any:  # fmt: skip
    """Solve over one piece by Diffrax; arguments are those of `follow_piece`."""
    dfx = diffrax()
    (x, alive), (times, values, _) = start, samples

    def field(time, x, given):
        alive, samples, params = given
        u = _input_at(jnp.minimum(time, limits.end), samples, kinds)
        return jnp.where(alive, jnp.asarray(rhs(time, x, u, params), dtype=float), 0.0)

    def exploded(time, x, given, **_):
        return ~jnp.all(jnp.abs(x) < limits.limit)

    # Shortest steps are taken whatever their error: at a singularity the state then leaves all bounds, or turns NaN,
    # and the run ends there; across a jump in the right-hand side they do no harm.
    rtol: Any = settings.rtol
    control = dfx.PIDController(rtol=rtol, atol=settings.atol * limits.sizes, dtmin=1e-12 * limits.span)
    if values.shape[1] and times.shape[0] > 2:
        # Inputs are not smooth at their samples; a step across one would waste many rejected attempts. A piece of two
        # rows has no inner sample, and the controller refuses an empty list.
        inner, held = times[1:-1], "zoh" in kinds
        control = dfx.ClipStepSizeController(control, step_ts=None if held else inner, jump_ts=inner if held else None)
    with ordered_times():
        return dfx.diffeqsolve(
            dfx.ODETerm(field),
            dfx.Dopri8() if settings.solver is None else settings.solver,
            t0=times[0],
            t1=times[-1],
            dt0=None,
            y0=x,
            args=(alive, samples, args),
            saveat=dfx.SaveAt(subs=(dfx.SubSaveAt(ts=times), dfx.SubSaveAt(t1=True))),
            stepsize_controller=control,
            event=dfx.Event(exploded),
            max_steps=settings.max_steps,
            adjoint=dfx.RecursiveCheckpointAdjoint() if settings.adjoint is None else settings.adjoint,
            throw=False,
        )


def joined(
    x0: Float[Array | np.ndarray, "*draw d"], t: Float[Array | np.ndarray, " n"],
    states: Float[Array | np.ndarray, "*draw piece rows d"], failed_at: Float[Array | np.ndarray, "*draw piece"],
) -> tuple[Float[Array | np.ndarray, "*draw n d"], Float[Array | np.ndarray | np.generic, "*draw"]]:  # fmt: skip
    """Join the pieces of one run: return its states at the times t, and the time of its first failure or NaN."""
    xp = namespace([x0, t, states, failed_at])
    rows = states.reshape(*x0.shape[:-1], -1, x0.shape[-1])
    whole = xp.concatenate([x0[..., None, :], rows], axis=-2)[..., : t.shape[0], :]
    first = xp.min(xp.where(xp.isnan(failed_at), xp.inf, failed_at), axis=-1)
    return whole, xp.where(first <= t[-1], first, xp.nan)


def between_samples(t: Float[np.ndarray, " n"], values: Float[np.ndarray, "n p"]) -> tuple[str, ...]:
    """Choose "linear" or "cubic" for each column: a sample is predicted better from two neighbours, or from four.

    Straight lines take five per cent of the amplitude of a sine that is sampled eight times a period; splines
    overshoot at steps. The cubic through the four neighbours wins where most of the signal lies below a third of
    the sampling rate. Fewer than nine samples get lines. Samples cannot show that an input is held between them: name
    "zoh".
    """
    if len(t) < 9:
        return ("linear",) * values.shape[1]
    t, inner = np.asarray(t, dtype=float), slice(2, len(t) - 2)

    def error(offsets: tuple[int, ...]) -> Float[np.ndarray, " p"]:
        # Lagrange's polynomial through the neighbours at these offsets, at the sample itself.
        at = {k: t[2 + k : len(t) - 2 + k] for k in offsets}
        predicted = np.zeros_like(values[inner])
        for k in offsets:
            weight = np.prod([(t[inner] - at[i]) / (at[k] - at[i]) for i in offsets if i != k], axis=0)
            predicted += weight[:, None] * values[2 + k : len(t) - 2 + k]
        return np.mean((predicted - values[inner]) ** 2, axis=0)

    return tuple("cubic" if better else "linear" for better in error((-2, -1, 1, 2)) < error((-1, 1)))


def between_samples_of_runs(
    runs: Sequence[tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n p"]]],
) -> tuple[str, ...]:
    """Choose as `between_samples` for several runs of times and values: "cubic" where every run says so."""
    each = [between_samples(t, values) for t, values in runs]
    # A step in one run is a step.
    return tuple("cubic" if set(kinds) == {"cubic"} else "linear" for kinds in zip(*each, strict=True))


def curvature_of(
    t: Float[Array | np.ndarray, " n"], values: Float[Array | np.ndarray, "n p"], kind: str | Sequence[str]
) -> tuple[tuple[str, ...], Float[np.ndarray, "n p"]]:
    """Return the interpolation of each column, and second derivatives at the samples: zero but for splines."""
    kinds, curvature = one_for_each(kind, values.shape[1]), np.zeros(values.shape)
    if "cubic" in kinds:
        if len(t) < 4:
            raise InputError(f"Cubic interpolation needs four samples, not {len(t)}; use interpolation='linear'.")
        times, cubic = np.asarray(t), np.array(kinds) == "cubic"
        curvature[:, cubic] = CubicSpline(times, np.asarray(values)[:, cubic])(times, 2)
    return kinds, curvature


def one_for_each(kind: str | Sequence[str], n: int) -> tuple[str, ...]:
    """Return the interpolation of each of n inputs, which may have one for all."""
    check_interpolation(kind)
    kinds = (kind,) * n if isinstance(kind, str) else tuple(str(each) for each in kind)
    if len(kinds) != n:
        raise InputError(f"{len(kinds)} interpolations for {n} inputs; give one for each, or one for all.")
    return kinds


def _input_at(time: Any, samples: Samples, kinds: tuple[str, ...]) -> Float[Array, " p"]:
    t, values, curvature = samples
    last = t.shape[0] - 1
    i = jnp.searchsorted(t, time, side="right") - 1
    held = values[jnp.clip(i, 0, last)]
    i = jnp.clip(i, 0, last - 1)
    h = t[i + 1] - t[i]
    b = (time - t[i]) / h
    a = 1.0 - b
    line = a * values[i] + b * values[i + 1]
    smooth = line + (a * (a**2 - 1) * curvature[i] + b * (b**2 - 1) * curvature[i + 1]) * h**2 / 6.0
    return jnp.where(np.array(kinds, dtype=str) == "zoh", held, smooth)
