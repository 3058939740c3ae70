"""The same model as one would write it by hand, in NumPyro and diffrax: no rows, no warm start."""

from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jaxtyping import Array, Float
from numpyro.infer import MCMC, NUTS

from .run import ERROR, INTERACTION, RATE, START


def model(time: Float[np.ndarray, " n"], pelts: Float[np.ndarray, "n 2"]) -> None:
    """Draw from Lotka and Volterra's equations with lognormal errors; pelts of hares and lynxes are in thousands."""
    drawn = {
        "alpha": dist.TruncatedNormal(*RATE, low=0.0),
        "beta": dist.TruncatedNormal(*INTERACTION, low=0.0),
        "gamma": dist.TruncatedNormal(*RATE, low=0.0),
        "delta": dist.TruncatedNormal(*INTERACTION, low=0.0),
        "start": dist.LogNormal(jnp.log(START[0]), START[1]).expand([2]),
        "sigma": dist.LogNormal(*ERROR).expand([2]),
    }
    values = {name: jnp.asarray(numpyro.sample(name, prior)) for name, prior in drawn.items()}
    alpha, beta, gamma, delta, start, sigma = values.values()

    def rate(t: Any, x: Any, args: Any) -> Array:
        u, v = x
        return jnp.stack([(alpha - beta * v) * u, (-gamma + delta * u) * v])

    path = diffrax.diffeqsolve(
        diffrax.ODETerm(rate), diffrax.Tsit5(), time[0], time[-1], None, start,
        saveat=diffrax.SaveAt(ts=jnp.asarray(time)), stepsize_controller=diffrax.PIDController(1e-6, 1e-6),
        max_steps=10_000, throw=False,
    ).ys  # fmt: skip
    numpyro.sample("y", dist.LogNormal(jnp.log(jnp.maximum(jnp.asarray(path), 1e-10)), sigma), obs=pelts)


def by_hand(
    time: Float[np.ndarray, " n"], pelts: Float[np.ndarray, "n 2"], draws: int, *, seed: int, progress: bool
) -> dict[str, Float[np.ndarray, "1 n_draw"]]:
    """Return one chain's draws by NUTS with NumPyro's own settings and a dense metric, after as many of warm-up."""
    mcmc = MCMC(NUTS(model, dense_mass=True), num_warmup=draws, num_samples=draws, progress_bar=progress)
    mcmc.run(jax.random.PRNGKey(seed), time, pelts)
    found = {name: np.asarray(value) for name, value in mcmc.get_samples(group_by_chain=True).items()}
    pairs = {"start": ("u(0)", "v(0)"), "sigma": ("sigma_u", "sigma_v")}
    apart = {each: found[name][..., k] for name, names in pairs.items() for k, each in enumerate(names)}
    return {**{name: found[name] for name in ("alpha", "beta", "gamma", "delta")}, **apart}
