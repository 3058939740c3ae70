"""Truths and targets drawn from a model, coefficient by coefficient: nothing here is integrated out.

This is the side of simulation-based calibration that must not share a mistake with the collapsed likelihood, so apart
from the sites of the prior it is NumPy on the rows as they were measured, not the compressed ones.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpyro.handlers import seed, trace

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.assemble import Equation
from bayes_greybox.model.kernels import KERNELS, log_spectral_density
from bayes_greybox.model.likelihood import DenseDesign, Design, FeatureDesign, Hyperparameters
from bayes_greybox.model.program import Program


@dataclass(frozen=True)
class Rows:
    """One equation with its rows before compression, whitened.

    Attributes:
        equation: Frame, and the design that the sampler gets, with a target still to be filled in.
        Phi: Dictionary, scaled units.
        Psi: Orthogonal features; no columns on the exact path.
        rotation: Q, [Φ Ψ̃] = Q R: the sampler sees R and Qᵀy.
    """

    equation: Equation
    Phi: Float[np.ndarray, "n_white n_term"]
    Psi: Float[np.ndarray, "n_white n_basis"]
    rotation: Float[np.ndarray, "n_white n_kept"]

    def compress(self, y: Float[np.ndarray, "n_replicate n_white"]) -> Float[np.ndarray, "n_replicate n_row"]:
        """Qᵀy, and the length of what Q cannot say as one more row."""
        if isinstance(self.equation.design, DenseDesign):
            return y
        kept = y @ self.rotation
        if self.rotation.shape[0] <= self.rotation.shape[1]:
            return kept
        # ‖y − QQᵀy‖ as a residual, not as a difference of squares
        return np.column_stack([kept, np.linalg.norm(y - kept @ self.rotation.T, axis=1)])


def calibration_rows(data: Trajectories, equation: Equation) -> Rows:
    """The rows of an equation and its design for targets other than the measured one.

    Args:
        data: What the equation was assembled from.
        equation: From `Program.assemble`.
    """
    noise = data.noise.get(equation.frame.equation)
    Phi, Psi = (np.asarray(part) for part in equation.frame.rows(data.columns))
    if noise is not None:
        Phi, Psi = noise.whiten(Phi), noise.whiten(Psi)
    if isinstance(equation.design, DenseDesign):
        return Rows(equation, Phi, Psi[:, :0], np.zeros((len(Phi), 0)))
    rotation, R = np.linalg.qr(np.column_stack([Phi, Psi]))
    R = np.vstack([R, np.zeros((int(len(Phi) > R.shape[1]), R.shape[1]))])
    features = jnp.asarray(R[:, Phi.shape[1] :])
    design = replace(
        equation.design,
        Phi=jnp.asarray(R[:, : Phi.shape[1]]),
        Psi=features,
        gram=features.T @ features,
        y=jnp.zeros(len(R)),
    )
    return Rows(replace(equation, design=design), Phi, Psi, rotation)


def draw_truths(
    model: Program, rows: Mapping[str, Rows], replicates: int, key: Array, generator: np.random.Generator
) -> tuple[dict[str, np.ndarray], dict[str, Float[np.ndarray, "n_replicate n_row"]]]:
    """Draw η and the prior scales from the prior, then γ, θ, f and y = Φθ + f + σε.

    Args:
        model: Model.
        rows: Its equations.
        replicates: Number of draws.
        key: Random key of the prior's sites.
        generator: Source of γ, θ, f and ε.

    Returns:
        True values under the names that posterior draws have, each [n_replicate, ...], and compressed targets.
    """
    designs: dict[str, Design] = {name: part.equation.design for name, part in rows.items()}

    def sites(key: Array) -> dict[str, Array]:
        found = trace(seed(model.numpyro_model, key)).get_trace(designs)
        values = {name: site["value"] for name, site in found.items() if name not in {f"{e}_y" for e in designs}}
        for name in designs:
            scales = found[f"{name}_y"]["fn"].scales
            values[f"{name}_theta_sd"] = scales.sd
            if scales.log_odds is not None:
                values[f"{name}_log_odds"] = scales.log_odds
        return values

    drawn = jax.jit(jax.vmap(sites))(jax.random.split(key, replicates))
    truths = {name: np.asarray(value) for name, value in drawn.items()}
    targets = {}
    for name, part in rows.items():
        sd = truths[f"{name}_theta_sd"]
        if f"{name}_log_odds" in truths:
            included = generator.random(sd.shape) < 1 / (1 + np.exp(-truths.pop(f"{name}_log_odds")))
            truths[f"{name}_gamma"] = included.astype(float)
            sd = truths[f"{name}_theta_sd"] = sd * included
        theta = truths[f"{name}_theta"] = sd * generator.standard_normal(sd.shape)
        f = _draw_f(part, truths, name, generator)
        epsilon = generator.standard_normal((replicates, len(part.Phi)))
        targets[name] = part.compress(theta @ part.Phi.T + f + truths[f"{name}_sigma"][:, None] * epsilon)
    return truths, targets


def _draw_f(part: Rows, truths: dict[str, np.ndarray], name: str, generator: np.random.Generator) -> np.ndarray:
    """F at the rows; its weights, or on the exact path its values, are put with the truths."""
    design = part.equation.design
    n = len(truths[f"{name}_sigma"])
    if isinstance(design, FeatureDesign):
        if design.Psi.shape[1] == 0:
            return np.zeros((n, len(part.Phi)))
        amplitude, length_scale = truths[f"{name}_amplitude"], truths[f"{name}_length_scale"]
        kernel = KERNELS[design.kernel]
        log_S = jax.vmap(lambda a, ell: log_spectral_density(kernel, design.frequency, a, ell))(amplitude, length_scale)
        S = np.exp(np.asarray(log_S))
        weight = np.sqrt(S) * generator.standard_normal(S.shape)
        if design.constraints is not None:
            weight = _condition(weight, S, np.asarray(design.constraints))
        truths[f"{name}_weight"] = weight
        return weight @ part.Psi.T
    covariance = jax.jit(lambda hyper: design.cross_covariance(design.points, hyper))
    f = np.empty((n, len(design.points[0])))
    for i in range(n):
        hyper = Hyperparameters(*(jnp.asarray(truths[f"{name}_{key}"][i]) for key in Hyperparameters._fields))
        values, vectors = np.linalg.eigh(np.asarray(covariance(hyper)))
        f[i] = vectors @ (np.sqrt(np.maximum(values, 0.0)) * generator.standard_normal(len(values)))
    truths[f"{name}_f"] = f
    return f if design.whitening is None else f @ np.asarray(design.whitening).T


def _condition(
    weight: Float[np.ndarray, "n n_basis"], S: Float[np.ndarray, "n n_basis"], C: Float[np.ndarray, "n_rank n_basis"]
) -> Float[np.ndarray, "n n_basis"]:
    """Draws of w given C w = 0 from free ones: w − S Cᵀ (C S Cᵀ)⁺ C w (Matheron's rule)."""
    out = np.empty_like(weight)
    for i, (w, s) in enumerate(zip(weight, S, strict=True)):
        # Least squares in standardised weights, so that C S Cᵀ is never formed.
        root = np.sqrt(s)
        z = w / np.where(root > 0, root, 1.0)
        out[i] = root * (z - np.linalg.pinv(C * root) @ (C @ w))
    return out
