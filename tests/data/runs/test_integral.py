import numpy as np

from bayes_greybox.data.runs.resampling import running_integral


def test_a_cubic_is_integrated_exactly():
    t = np.sort(np.random.default_rng(0).uniform(0, 2, 12))

    def path(time):
        return time**4 - time**2

    np.testing.assert_allclose(running_integral(t, 4 * t**3 - 2 * t), path(t) - path(t[0]), atol=1e-12)
