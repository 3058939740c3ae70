"""Values of several nonlinear parameters: what they weigh adds up to integrals over the unit cube."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayes_greybox.discovery.regressors.columns import CLOUD_POINTS, Cloud, weights_of


def grid(*counts):
    axes = [(np.arange(n) + 0.5) / n for n in counts]
    return np.stack([x.ravel() for x in np.meshgrid(*axes, indexing="ij")], axis=-1)


@pytest.mark.parametrize("off", [0.0, 1.0], ids=["at the mode", "a standard deviation aside"])
def test_a_narrow_peak_is_integrated(off):
    """Far narrower than the first grid, and correlated: the sum over all points is the integral, which is one."""
    spread = np.array([0.02, 0.03, 0.01])
    tilted = np.array([[1.0, 0.7, 0.0], [0.7, 1.0, 0.3], [0.0, 0.3, 1.0]]) * np.outer(spread, spread)
    mode = np.array([0.4, 0.6, 0.55])
    first = grid(6, 3, 2)
    cloud = Cloud.around(mode + off * spread, 1.5**2 * tilted)
    again = Cloud.around(mode, 1.5**2 * tilted)
    at = np.vstack([first, cloud.points, again.points])
    drawn = [None] * len(first) + [cloud] * len(cloud.points) + [again] * len(again.points)
    total = np.exp(weights_of(at, drawn)) @ multivariate_normal(mode, tilted).pdf(at)
    # So many points, of which about a third count, say as much.
    assert total == pytest.approx(1.0, abs=3 / np.sqrt(2 * CLOUD_POINTS / 3))


def test_a_flat_likelihood_weighs_as_much_as_it_did_on_the_grid_alone():
    first = grid(6, 3)
    cloud = Cloud.around(np.array([0.9, 0.5]), np.diag([0.04, 0.01]))
    at = np.vstack([first, cloud.points])
    assert np.all((cloud.points > 0) & (cloud.points < 1)) and cloud.inside < 0.8
    total = np.sum(np.exp(weights_of(at, [None] * len(first) + [cloud] * len(cloud.points))))
    assert total == pytest.approx(1.0, abs=0.15)
