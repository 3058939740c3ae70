"""Truths and targets drawn from a model, coefficient by coefficient, with nothing integrated out.

Simulation-based calibration compares these with the collapsed likelihood, and must not share its mistakes. So apart
from the sites of the prior this is NumPy on the rows as they were measured, not the compressed ones.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpyro.handlers import seed, trace
from scipy.stats import truncnorm

from bayes_greybox.model.design import Compress, Design
from bayes_greybox.model.equation import Equation
from bayes_greybox.model.gp.hyper import Hyperparameters
from bayes_greybox.model.program import Program


@dataclass(frozen=True)
class OpenEquation:
    """One equation whose targets are still to be drawn, with the design that the sampler gets.

    Φ and the orthogonal Ψ, scaled units, are those at the whitened rows before compression; `compress` takes targets
    from there to the rows of the design.
    """

    equation: Equation
    Phi: Float[np.ndarray, "n_white n_term"]
    Psi: Float[np.ndarray, "n_white n_basis"]
    compress: Compress


def open_equation(equation: Equation) -> OpenEquation:
    """Return an assembled equation with a design for targets other than the measured one."""
    Phi, Psi, _ = equation.parts()
    Phi, Psi = equation.rows.whiten(Phi), equation.rows.whiten(Psi)
    design, compress = equation.design.open(Phi, Psi)
    return OpenEquation(replace(equation, design=design), Phi, Psi, compress)


def draw_truths(
    model: Program, open_equations: Mapping[str, OpenEquation], replicates: int, key: Array,
    generator: np.random.Generator,
) -> tuple[dict[str, np.ndarray], dict[str, Float[np.ndarray, "n_replicate n_row"]]]:  # fmt: skip
    """Draw η and the prior scales from the prior with the key, then γ, θ, f and y = Φθ + f + σε with the generator.

    Returns:
        True values under the names of posterior draws, each [n_replicate, ...], and compressed targets.
    """
    designs: dict[str, Design] = {name: part.equation.design for name, part in open_equations.items()}

    def draw(key: Array) -> dict[str, Array]:
        sites = trace(seed(model.numpyro_model, key)).get_trace(designs)
        values = {name: site["value"] for name, site in sites.items()}
        for own in model.sites.values():
            del values[own.y]
            values.pop(own.placement, None)
            scales = sites[own.y]["fn"].scales
            values[own.theta_sd] = scales.sd
            if scales.log_odds is not None:
                values[own.log_odds] = scales.log_odds
        return values

    drawn = jax.jit(jax.vmap(draw))(jax.random.split(key, replicates))
    truths = {name: np.asarray(value) for name, value in drawn.items()}
    targets = {}
    for name, part in open_equations.items():
        own, coefficients = model.sites[name], part.equation.design.coefficients
        sd = truths[own.theta_sd]
        if own.log_odds in truths:
            included = generator.random(sd.shape) < 1 / (1 + np.exp(-truths.pop(own.log_odds)))
            included[:, list(coefficients.certain)] = True
            truths[own.gamma] = included.astype(float)
            sd = truths[own.theta_sd] = sd * included
        theta = sd * generator.standard_normal(sd.shape)
        for j in coefficients.bounded:
            scale, mean = np.where(sd[:, j] > 0, sd[:, j], 1.0), float(coefficients.mean[j])
            low, high = ((float(limit[j]) - mean) / scale for limit in (coefficients.lower, coefficients.upper))
            theta[:, j] = sd[:, j] * truncnorm.rvs(low, high, size=len(sd), random_state=generator)
        theta = truths[own.theta] = np.where(sd > 0, np.asarray(coefficients.mean) + theta, 0.0)
        absent = np.ones(replicates)
        hyper = Hyperparameters(*(jnp.asarray(truths.get(own[key], absent)) for key in Hyperparameters._fields))
        values, f = part.equation.design.simulate(hyper, part.Psi, generator)
        truths |= {own[quantity]: value for quantity, value in values.items()}
        epsilon = generator.standard_normal((replicates, len(part.Phi)))
        targets[name] = part.compress(theta @ part.Phi.T + f + truths[own.sigma][:, None] * epsilon)
    return truths, targets
