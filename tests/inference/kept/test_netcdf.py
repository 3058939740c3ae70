"""The file of a fit."""

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest

import bayes_greybox as bg
from bayes_greybox.model.priors import Scales


def test_names_of_the_users_own_do_not_clash_with_those_of_the_file(tmp_path):
    class Normal:  # noqa: N801 - called as one of the package's
        def scales(self, n_term, n_obs, sigma):
            return Scales(jnp.full(n_term, numpyro.sample("v", dist.HalfNormal(2.0))))

    rng, t = np.random.default_rng(0), 0.1 * np.arange(30)
    y, taken = rng.uniform(-1, 1, (2, 30))
    rate = -y + 0.5 * taken + 0.1 * rng.standard_normal(30)
    data = bg.Trajectories.from_arrays(t, states={"y": y}, inputs={"y_rate": taken}, derivatives={"y": rate})
    model = bg.GreyBox(dictionary={"y": ["y", "y_rate"]}, prior=Normal(), discrepancy=None)
    fit = model.fit(data, draws=50, tune=50, chains=1, progress=False)
    assert fit.idata["posterior"]["y_v"].dims == ("chain", "draw")
    fit.save(tmp_path / "run.nc")
    again = bg.load(tmp_path / "run.nc")
    np.testing.assert_array_equal(again.data.inputs["y_rate"], taken)
    np.testing.assert_array_equal(again.data.derivatives["y"], data.derivatives["y"])
    # A file cannot hold the user's class: it must not come back as the package's prior of the same name.
    assert not isinstance(again.model.prior, bg.Normal)
    with pytest.raises(bg.InputError, match="prior was a Python program"):
        again.model.fit(data, draws=50, tune=50, chains=1, progress=False)
