"""Effective samples per second against the same model written by hand in NumPyro with θ sampled.

The hand-written model is the usual one: θ as a site with a Laplace prior, f marginalised in a multivariate normal with
the projected squared-exponential kernel, exact. Both run in this process, one after the other, on one
data set; seconds are wall time with compilation; the figure is the smallest bulk ESS over θ, σ, amplitude and ℓ.

    python -m pytest -n 0 -m slow tests/benchmarks/test_speed.py -s
"""

import time

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from arviz_stats.base import array_stats
from numpyro.infer import MCMC, NUTS

import bayes_greybox as bg

COMPLETE = ["y", "ydot", "y**2", "ydot**2", "y**3", "ydot**3"]
PARTIAL = [term for term in COMPLETE if term != "y**3"]
CHAINS, TUNE, DRAWS = 2, 500, 1000
"""Settings of both. The hand-written model's chains run one after the other, NumPyro's way on a CPU; side by side
(`numpyro.set_host_device_count`) they took longer on two cores: a gradient then took two to three times as long."""

PIECE, PATIENCE = 50, 3600.0
"""Draws that the hand-written model makes at a time, and seconds after which it makes no more."""


def smallest_ess(draws: dict[str, np.ndarray]) -> float:
    columns = [np.reshape(v, (*v.shape[:2], -1)) for v in draws.values()]
    stacked = np.concatenate(columns, axis=2)
    return float(min(array_stats.ess(stacked[..., i], chain_axis=0, draw_axis=1) for i in range(stacked.shape[2])))


def by_hand(Phi, x, y, floor):
    """What a user would write, in scaled units."""
    Phi, x, y = jnp.asarray(Phi), jnp.asarray(x), jnp.asarray(y)
    n, k = Phi.shape
    away = jnp.eye(n) - Phi @ jnp.linalg.solve(Phi.T @ Phi, Phi.T)

    def model():
        tau = numpyro.sample("tau", dist.HalfNormal(1.0))
        theta = numpyro.sample("theta", dist.Laplace(0, tau).expand([k]).to_event(1))
        amplitude = numpyro.sample("amplitude", dist.HalfNormal(1.0))
        length = numpyro.sample("length", dist.LogNormal(0, 0.5).expand([x.shape[1]]).to_event(1))
        noise = numpyro.sample("noise", dist.HalfNormal(1.0))
        squares = jnp.sum(((x[:, None] - x[None]) / length) ** 2, axis=-1)
        K = away @ (amplitude**2 * jnp.exp(-0.5 * squares)) @ away
        covariance = K + (floor**2 + noise**2) * jnp.eye(n)
        numpyro.sample("y", dist.MultivariateNormal(Phi @ theta, covariance), obs=y)

    return model


@pytest.mark.slow
@pytest.mark.parametrize("n_obs", [100, 200, 400])
@pytest.mark.parametrize("dictionary", ["complete", "partial"])
def test_faster_than_theta_sampled_by_hand(dictionary, n_obs, capsys):
    data = bg.systems.oscillator().simulate(t=np.linspace(0, 100, n_obs), noise=0.02, seed=1)
    model = bg.GreyBox(dictionary={"ydot": COMPLETE if dictionary == "complete" else PARTIAL}, prior=bg.Laplace())

    start = time.perf_counter()
    fit = model.fit(data, chains=CHAINS, tune=TUNE, draws=DRAWS, seed=0, progress=False)
    ours = time.perf_counter() - start
    group = fit.idata["posterior"]
    names = ("theta", "sigma", "amplitude", "length_scale")
    our_rate = smallest_ess({name: group[f"ydot_{name}"].to_numpy() for name in names}) / ours

    frame = fit.equations["ydot"].frame
    Phi, y = np.asarray(frame.dictionary_rows(data.columns)), data.derivatives["ydot"] / frame.target_scale
    program = by_hand(Phi, np.asarray(frame.position(data.columns)), y, 1e-4)
    start = time.perf_counter()
    sampler = NUTS(program, target_accept_prob=0.9)
    settings = {"num_warmup": TUNE, "num_samples": PIECE, "num_chains": CHAINS, "chain_method": "sequential"}
    mcmc = MCMC(sampler, **settings, progress_bar=False)
    mcmc.warmup(jax.random.PRNGKey(0))
    pieces = []
    while len(pieces) * PIECE < DRAWS and (not pieces or time.perf_counter() - start < PATIENCE):
        mcmc.run(mcmc.post_warmup_state.rng_key)
        pieces.append(mcmc.get_samples(group_by_chain=True))
        mcmc.post_warmup_state = mcmc.last_state
    theirs = time.perf_counter() - start
    samples = {name: np.concatenate([np.asarray(piece[name]) for piece in pieces], axis=1) for name in pieces[0]}
    hand_rate = smallest_ess({k: samples[k] for k in ("theta", "noise", "amplitude", "length")}) / theirs
    with capsys.disabled():
        print(
            f"\n| {dictionary} | {n_obs} | {our_rate:.1f} ({ours:.0f} s) | {hand_rate:.2f} "
            f"({samples['tau'].size} draws, {theirs:.0f} s) | "
            f"{our_rate / hand_rate:.0f}x |"
        )
    assert our_rate > hand_rate
