"""Controls: their answer is clear, and a study that sees traps everywhere fails here."""

import numpy as np

from bayes_greybox.data.trajectories import Trajectories

from .trap import multisine, noisy, path, recorded, staircase, trap


@trap(21, {"x": "v", "v": "-10*x - 0.5*v + u"}, hold="held", answer="no gap")
def _control_nothing(rng: np.random.Generator) -> Trajectories:
    """White noise, a held input, all coefficients right."""
    n, step = 2000, 0.02
    t = step * np.arange(n)
    u, breaks = staircase(rng, n * step, 0.5, 5.0)
    x, _ = path(lambda _, x, u: (x[1], -10 * x[0] - 0.5 * x[1] + u), (0.3, 0.0), t, u, breaks=breaks)
    return recorded(t, noisy(rng, x, 0.02), u(t))


@trap(22, {"x": "v", "v": "-10*x - 0.5*v + u"}, wanted={"cubic-stiffness"})
def _control_cubic(rng: np.random.Generator) -> Trajectories:
    """A strong cubic spring, a broad drive, white noise."""
    t = 0.01 * np.arange(3000)
    u = multisine(rng, 1.0, 4.5, 9, 5.0)
    x, _ = path(lambda _, x, u: (x[1], -10 * x[0] - 0.5 * x[1] - 4 * x[0] ** 3 + u), (0.0, 0.0), t, u)
    return recorded(t, noisy(rng, x, 0.02), u(t))


@trap(
    23,
    {"x": "v", "v": "-15*x - 0.4*v + u"},
    hold="held",
    # Its sign is smooth over 0.05 of speed, which is smooth friction to the letter.
    wanted={"coulomb-friction", "smooth-friction"},
    allowed={"stribeck-friction", "exponential-stribeck-friction"},
)
def _control_coulomb(rng: np.random.Generator) -> Trajectories:
    """Dry friction in two runs with held inputs, white noise."""
    n, step = 1000, 0.015
    t = step * np.arange(n)
    paths, inputs = [], []
    for level, start in ((3.0, 0.0), (1.5, 0.8)):
        u, breaks = staircase(rng, n * step, 0.6, level)
        paths.append(path(_rubbing, (start, 0.0), t, u, breaks=breaks)[0])
        inputs.append(u(t))
    x = noisy(rng, np.concatenate(paths), 0.01)
    return recorded([t, t], np.split(x, 2), inputs)


def _rubbing(_: float, x: np.ndarray, u: float) -> tuple[float, float]:
    return x[1], -15 * x[0] - 0.4 * x[1] - 0.8 * np.tanh(x[1] / 0.05) + u


@trap(24, {"x": "v", "v": "-14.5*x - 0.6*v - 8*x**3 + u"}, wanted={"linear-stiffness"}, answer="recalibrate")
def _control_literal(rng: np.random.Generator) -> Trajectories:
    """One coefficient is −14.5 and should be −16; all else is exact."""
    t = 0.01 * np.arange(2500)
    u = multisine(rng, 1.0, 5.0, 9, 5.0)
    x, _ = path(lambda _, x, u: (x[1], -16 * x[0] - 0.6 * x[1] - 8 * x[0] ** 3 + u), (0.2, 0.0), t, u)
    return recorded(t, noisy(rng, x, 0.015), u(t))


@trap(25, {"x": "v", "v": "-2*x - 0.15*v + u"}, wanted={"signed-quadratic-stiffness"})
def _control_digital_loop(rng: np.random.Generator) -> Trajectories:
    """A controller whose output stays until its next sample, which nobody says: between straight lines the force is
    half a step early, as if the actuator lagged.
    """
    n, step = 800, 0.1
    t = step * np.arange(n)
    wanted, shown, u = multisine(rng, 0.3, 3.0, 12, 1.5), np.zeros(n), np.zeros(n)
    x, error = np.zeros(2), 0.02 * rng.standard_normal(n)
    for k in range(n):
        # What was measured is what the controller knows.
        shown[k] = x[0] + error[k]
        u[k] = wanted(t[k]) - 1.5 * shown[k] - 0.3 * x[1]

        def rates(_: float, x: np.ndarray, u: float) -> tuple[float, float]:
            return x[1], -2 * x[0] - 0.15 * x[1] - 0.8 * x[0] * abs(x[0]) + u

        x = path(rates, tuple(x), np.array([0.0, step]), lambda _, u=u[k]: u)[:, -1]
    return recorded(t, shown, u)


@trap(27, {"x": "v", "v": "-100*x - 0.33*v + u/1.2"}, wanted={"quadratic-drag"})
def _control_gap(rng: np.random.Generator) -> Trajectories:
    """The logger lost a second of a rig with quadratic drag, its drive included: a line through the gap drives the path
    elsewhere, and offsets, a dead zone and backlash explain that.
    """
    t = 0.02 * np.arange(1500)
    u = multisine(rng, 1.9, 14.5, 7, 3.2)

    def rates(_, x, u):
        return x[1], -100 * x[0] - 0.33 * x[1] - 2.5 * x[1] * abs(x[1]) + u / 1.2

    x, _ = path(rates, (0.0, 0.0), t, u)
    kept = (t <= 12.0) | (t >= 13.1)
    return recorded(t[kept], noisy(rng, x, 0.005)[kept], u(t)[kept])
