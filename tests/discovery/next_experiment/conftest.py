"""A tie, studied once for all tests of this folder."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import bayes_greybox as bg
from bayes_greybox.missing_effects import Study
from bayes_greybox.physics.catalogue.loading import load_catalogue


@pytest.fixture(scope="package")
def study() -> Study:
    """A spring that hardens a little, seen at small amplitude: several stiffnesses could be it."""
    t, rng = np.linspace(0, 8, 81), np.random.default_rng(0)

    def rate(s: float, x: np.ndarray) -> list[float]:
        return [x[1], 2 * np.sin(2 * s) - 4 * x[0] - 0.5 * x[1] - 1.5 * x[0] ** 3]

    y, v = solve_ivp(rate, (0, 8), [0.6, 0.0], t_eval=t, rtol=1e-9, atol=1e-9).y
    F = 2 * np.sin(2 * t)
    a = F - 4 * y - 0.5 * v - 1.5 * y**3 + 0.3 * rng.standard_normal(81)
    data = bg.Trajectories.from_arrays(t, states={"y": y, "v": v}, inputs={"F": F}, derivatives={"v": a})
    model = bg.GreyBox({"v": []}, simulation={"y": "v", "v": "F - 4*y - 0.5*v"})
    several = [each for each in load_catalogue("mechanical") if each.slug.endswith("-stiffness")]
    given = {"settle": False, "free_runs": False, "progress": False}
    return bg.find_missing_effects(model, data, catalogue=several, **given)
