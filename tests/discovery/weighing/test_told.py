"""A memory is told as one, and a force that nobody measured is not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tiny_equation import CUBE, DEAD_ZONE, forced, forced_model, on, tiny_model

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.equation_study import EquationStudy
from bayes_greybox.discovery.equation import study_equation
from bayes_greybox.discovery.evidence.columns import at_values
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.discovery.weighing.alignment import align
from bayes_greybox.discovery.weighing.sets import MEMORY, Explanation
from bayes_greybox.discovery.weighing.told import told
from bayes_greybox.discovery.weighing.worlds import World, under
from bayes_greybox.greybox import GreyBox
from bayes_greybox.missing_effects import find_missing_effects
from bayes_greybox.model.noise.noise_model import NoiseModel

FINE = 20
"""Euler steps between samples."""


def studied(simulation: dict, states: dict, rate: str, F: np.ndarray, noise: float, step: float) -> EquationStudy:
    """The study of a rate with white noise, of samples of a path in fine steps."""
    rng, n = np.random.default_rng(5), len(F) // FINE
    kept = {name: x[::FINE] for name, x in states.items() if name != "rate"}
    measured = states["rate"][::FINE] * 1.0
    measured += noise * np.std(measured) * rng.standard_normal(n)
    data = Trajectories.from_arrays(
        step * np.arange(n), states=kept, inputs={"F": F[::FINE]}, derivatives={rate: measured}
    )
    model = tiny_model(simulation=simulation)
    return study_equation(model, data, rate, [on(CUBE)], Odds(), 2, 0, False, lambda text: None)


def waves(n: int, step: float, *each: tuple[float, float, float]) -> np.ndarray:
    t = step / FINE * np.arange(n * FINE)
    return sum((size * np.sin(w * t + p) for size, w, p in each), np.zeros(len(t)))


def gust(n: int, step: float, size: float, seed: int) -> np.ndarray:
    """An Ornstein-Uhlenbeck force with a time of 0.4."""
    e, a = np.random.default_rng(seed).standard_normal(n * FINE), np.exp(-step / FINE / 0.4)
    g = np.zeros(len(e))
    for k in range(1, len(g)):
        g[k] = a * g[k - 1] + size * np.sqrt(1 - a * a) * e[k]
    return g


def remembering(study: EquationStudy) -> float:
    """Probability of the likeliest memory of the answer's table, laws that no catalogue has left out."""
    known = study.finding.weighed.by_memory
    return max((p for name, p in known.items() if not name.startswith(("law", "drift"))), default=0.0)


@pytest.mark.slow
def test_a_gust_that_the_speed_tells_is_unknown_and_no_memory():
    n, step = 400, 0.2
    F, g = waves(n, step, (1, 0.9, 0), (0.8, 1.7, 1), (0.6, 2.6, 2)), gust(n, step, 0.5, 2)
    x, v, a = (np.zeros(len(F)) for _ in range(3))
    for k in range(len(F)):
        a[k] = F[k] - 2 * x[k] - 0.3 * v[k] + g[k]
        if k + 1 < len(F):
            v[k + 1] = v[k] + a[k] * step / FINE
            x[k + 1] = x[k] + v[k + 1] * step / FINE
    simulation = {"x": "v", "v": "F - 2*x - 0.3*v"}
    study = studied(simulation, {"x": x, "v": v, "rate": a}, "v", F, 0.01, step)
    assert study.finding.verdict == "unknown" and study.finding.explanation.memory
    assert remembering(study) < 0.1


def first_order(force: np.ndarray, remembers: float) -> EquationStudy:
    """ẋ = F − x + force − r z, ż = ẋ − z."""
    n, step = len(force) // FINE, 0.1
    F = waves(n, step, (1, 0.7, 0), (0.8, 1.9, 1), (0.6, 0.31, 2))
    x, a, z = np.zeros(len(F)), np.zeros(len(F)), 0.0
    for k in range(len(F)):
        a[k] = F[k] - x[k] + force[k] - remembers * z
        if k + 1 < len(F):
            x[k + 1], z = x[k] + a[k] * step / FINE, z + (a[k] - z) * step / FINE
    return studied({"x": "F - x"}, {"x": x, "rate": a}, "x", F, 0.02, step)


@pytest.mark.slow
def test_a_gust_beside_a_delay_is_no_memory_of_the_input():
    study = first_order(gust(400, 0.1, 0.4, 0), 0.0)
    assert study.finding.verdict == "unknown" and remembering(study) < 0.1


def test_what_remembers_the_studied_state_is_told():
    study = first_order(np.zeros(400 * FINE), 0.8)
    assert study.finding.verdict == "unknown" and study.finding.weighed.by_memory["relaxation of x"] > 0.99


def test_a_world_is_told_by_its_own_columns():
    """It has a width of a dead zone more, and the world that the rows come with knows nothing of that."""
    zone = on(DEAD_ZONE, "y")
    first = align(forced_model(), forced(), "v", [zone], Odds(), 1).sets
    noise = NoiseModel(first.statistics.rows.noise)
    sets = under(first, noise)
    known = sets.evaluations
    fresh = len(first.statistics.columns)
    sets.statistics.add("effect", at_values(zone, np.array([[0.4321]]), np.zeros(1)))
    columns = sets.statistics.columns
    memory = tuple(i for i in sets.statistics.of_kind("memory") if columns[i].memory.text == "relaxation of v")
    value = sets.parametric((fresh, *memory)).all
    best = Explanation((), (fresh,), MEMORY, value - 5.0, value, memory=memory)
    (after,) = told([World(noise, known, (best,), 0.0)], first)
    (expected,) = told([World(noise, known, (best,), 0.0)], sets)
    assert after.best.remembers == pytest.approx(expected.best.remembers)
    assert replace(after.best, remembers=1.0) == best


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, 6, 10])
def test_a_vibration_absorber_that_the_simulation_lacks_is_said_to_remember(seed):
    rng, t = np.random.default_rng(seed), np.linspace(0, 60, 601)
    omega, phase = rng.uniform(0.5, 8, 12), rng.uniform(0, 2 * np.pi, 12)

    def force(s):
        return 3 * np.sin(np.multiply.outer(s, omega) + phase).sum(-1)

    def absorber(x):
        return 0.1 * (16 * (x[2] - x[0]) + 0.4 * (x[3] - x[1]))

    def rates(s, x):
        return [x[1], force(s) - 12 * x[0] - 0.6 * x[1] + absorber(x), x[3], -absorber(x) / 0.1]

    x = solve_ivp(rates, (0, 60), [0.1, 0, 0.1, 0], t_eval=t, rtol=1e-9, atol=1e-10).y
    rate = force(t) - 12 * x[0] - 0.6 * x[1] + absorber(x)
    rate = rate + 0.02 * rate.std() * rng.standard_normal(len(t))
    data = Trajectories.from_arrays(t, states={"y": x[0], "v": x[1]}, inputs={"F": force(t)}, derivatives={"v": rate})
    study = find_missing_effects(
        GreyBox(simulation={"y": "v", "v": "F - 12*y - 0.6*v"}, dictionary={"v": []}),
        data,
        settle=False,
        progress=False,
        catalogue="mechanical",
    )
    assert study.verdict == "unknown" and "it remembers" in study.sentence
