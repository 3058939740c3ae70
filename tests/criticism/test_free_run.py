"""Free runs of fits whose draws are written down by hand."""

import jax.numpy as jnp
import numpy as np
import pytest
from fabricated import fabricate

from bayes_greybox.criticism.bands import band_holds
from bayes_greybox.criticism.free_run import FreeRunner, free_run
from bayes_greybox.data.samples.starts import estimate_starts
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.program import Program
from bayes_greybox.report.plots.fits import simulated

DRAWS = {"chains": 2, "draws": 30}


def swinging(noise=0.0, n=201, runs=1) -> Trajectories:
    """y'' = −y, each run from another place, with noise on the states."""
    rng = np.random.default_rng(4)
    t = np.linspace(0, 4, n)
    y, v = [np.cos(t + i) for i in range(runs)], [-np.sin(t + i) for i in range(runs)]
    noisy = [[x + noise * rng.standard_normal(n) for x in column] for column in (y, v)]
    return Trajectories.from_arrays(
        [t] * runs, states={"y": noisy[0], "v": noisy[1]}, derivatives={"v": [-x for x in y]}
    )


def fitted(data, spread, features=None):
    """Draws of the coefficient of y around −1, and weights of f that are white."""
    gp = None if features is None else OrthogonalGP(features=features)
    model = Program(simulation={"y": "v"}, dictionary={"v": ["y"]}, discrepancy=gp)
    frame = model.assemble(data)["v"].frame
    rng = np.random.default_rng(0)
    theta = (-1 + spread * rng.standard_normal((2, 30, 1))) / frame.coefficient_scale
    more = {"theta": theta}
    if frame.basis is not None:
        more["weight"] = 0.02 * rng.standard_normal((2, 30, frame.basis.size))
    return fabricate(model, data, **DRAWS, **more)


def test_exact_states_start_where_they_were_measured():
    data = swinging()
    run = free_run(fitted(data, 0.01), data)
    assert run.holds == "90 % band: coefficients"
    assert run.states["y"].sd[0] == 0 and run.states["y"].mean[0] == data.states["y"][0]
    assert run.nrmse()["y"] < 0.01


def test_each_draw_has_its_own_start_of_each_run():
    data = swinging(0.05, runs=2)
    starts = estimate_starts(data)
    run = free_run(fitted(data, 0.0), data, at_most=60)
    assert run.holds == "90 % band: coefficients, start"
    for k, name in enumerate(("y", "v")):
        first = [0, 201]
        # 60 draws: the spread is within 40 % at more than four standard errors.
        np.testing.assert_allclose(run.states[name].sd[first], starts.sd[:, k], rtol=0.4)
        assert np.all(np.abs(run.states[name].mean[first] - starts.mean[:, k]) < 0.6 * starts.sd[:, k])
    # y = y₀ cos t + v₀ sin t: the spread of the start lasts.
    assert run.states["y"].sd[200] > 0.3 * starts.sd[0].min()


def test_the_band_of_a_free_run_covers_the_true_path():
    data = swinging(0.1, runs=12)
    band = free_run(fitted(data, 0.0), data, at_most=60).states["y"]
    y = np.cos(data.time + data.run)
    # A path hangs together, so 12 runs are some thirty independent places: 0.9 ± 0.06.
    assert np.mean((band.lower <= y) & (y <= band.upper)) > 0.7


def test_f_is_in_the_band_and_the_legend_of_its_figure():
    data = swinging(runs=2)
    run = free_run(fitted(data, 0.01, features=4), data)
    assert run.holds == "90 % band: coefficients, f"
    figure = simulated(run, "y")
    assert run.holds in [text.get_text() for text in figure.legends[0].get_texts()]


def test_what_a_band_holds_is_said_in_order_and_nothing_says_nothing():
    assert band_holds(0.95, {"coefficients": True, "f": False, "start": True}) == "95 % band: coefficients, start"
    assert band_holds(0.9, {"start": False}) == ""


@pytest.mark.parametrize("runs", [1, 2])
def test_every_draw_begins_at_its_own_starts(runs):
    data = swinging(runs=runs)
    starts = np.random.default_rng(0).standard_normal((2, runs, 2))
    states, failed_at = FreeRunner(lambda t, x, u, c: c * x)(data, np.array([0.1, 0.2]), starts)
    np.testing.assert_array_equal(states[:, np.arange(runs) * 201], starts)
    assert failed_at.shape == (runs, 2) and np.isnan(failed_at).all()


@pytest.mark.slow
def test_friction_that_rises_steeply_at_rest_is_followed_to_the_end():
    # An explicit method spends its steps where the mass sticks.
    t = np.arange(0.0, 20.0, 0.05)
    push = np.where(t < 8, np.sin(1.3 * t), 0.0)
    data = Trajectories.from_arrays(t, states={"y": np.cos(t), "v": np.sin(t)}, inputs={"F": push})

    def rate(t, x, u, friction):
        return jnp.stack([x[1], u[0] - 4 * x[0] - friction * jnp.tanh(x[1] / 1e-5)])

    runner = FreeRunner(rate, "linear", rtol=1e-6, atol=1e-7)
    # Without friction nothing is stiff, and nothing done again.
    starts = np.tile([0.3, 0.0], (3, 1, 1))
    plain, _ = runner(data, jnp.zeros(3), starts)
    states, failed_at = runner(data, jnp.array([0.2, 0.25, 0.0]), starts)
    assert np.all(np.isnan(failed_at)) and np.all(np.isfinite(states))
    np.testing.assert_allclose(states[2], plain[0], rtol=1e-9, atol=1e-12)
    states = states[:2]
    # It comes to rest where the spring is weaker than the friction.
    assert np.all(np.abs(states[:, -1, 1]) < 1e-4) and np.all(np.abs(4 * states[:, -1, 0]) < [0.2, 0.25])


def test_coulomb_friction_keeps_a_mass_at_rest():
    t = np.arange(0.0, 20.0, 0.05)
    push = np.where(t < 8, np.sin(1.3 * t), 0.0)
    model = Program(simulation={"y": "v", "v": "F - 4*y - 0.2*sign(v)"}, dictionary={"v": ["y"]}, discrepancy=None)
    data = Trajectories.from_arrays(
        t, states={"y": 0.3 * np.cos(t), "v": -0.3 * np.sin(t)}, inputs={"F": push},
        derivatives={"v": push - 1.2 * np.cos(t) + 0.3 * np.sign(np.sin(t))},
    )  # fmt: skip
    run = free_run(fabricate(model, data, theta=np.zeros((2, 3, 1))), data)
    assert not np.any(run.failed)
    y, v = (run.states[name].mean for name in ("y", "v"))
    assert abs(v[-1]) < 1e-3 and 4 * abs(y[-1]) < 0.2
    # What sticks creeps, and hardly: the last five seconds at rest.
    assert np.ptp(y[-100:]) < 1e-3
