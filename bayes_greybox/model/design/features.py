"""The feature path: rows [Φ Ψ̃ y] compressed to a triangular factor, whatever their number."""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float, Int

from bayes_greybox.model.algebra.collapsed import FeatureSolve, Regression, constraint_directions, remove_features
from bayes_greybox.model.algebra.compression import triangular_factor
from bayes_greybox.model.algebra.linalg import solve_lower_transposed
from bayes_greybox.model.frame import Frame
from bayes_greybox.model.gp.hyper import Hyperparameters
from bayes_greybox.model.gp.kernels import KERNELS, log_spectral_density
from bayes_greybox.model.priors import Scales
from bayes_greybox.model.rows.equation_rows import Columns, EquationRows, Removal, Table
from bayes_greybox.model.sites import site
from bayes_greybox.running.arrays import on_device

from .protocol import Compress, DesignRows, EquationDraws, Numbers, PickRows, Root, Theta, WeightedRows, Weights


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FeatureDesign(DesignRows):
    """Rows of one equation on the feature path: [Φ Ψ̃ y], whitened, scaled, compressed to a triangular factor.

    The rotation that compresses the rows leaves the likelihood as it is; `n_obs` rows stand behind `y`. Without a
    discrepancy the features have no columns. `gram` is Ψ̃ᵀΨ̃, `frequency` √λ of each feature in every direction, and
    `constraints` ⟨Φₒ, ψᵀ⟩ of the conditioned kernel.

    Arguments of the methods are the same here and in `DenseDesign`: `hyper` is η, `table` [Φ Ψ̃ y] at rows of the data
    in scaled units, `weight` and `f` the weights of f or its values at the data, without columns where f has the other.
    """

    expands = True

    Psi: Float[Array, "n_row n_basis"]
    gram: Float[Array, "n_basis n_basis"]
    frequency: Float[Array, "n_basis n_var"]
    constraints: Float[Array, "n_rank n_basis"] | None
    kernel: str = field(metadata={"static": True})

    @property
    def n_var(self) -> int:
        """Number of variables that f depends on."""
        return self.frequency.shape[1]

    def worthwhile(self, draws: int) -> int:
        """Return all of so many posterior draws, since one costs a product."""
        return draws

    def weight_prior(self, hyper: Hyperparameters) -> tuple[Array, Array | None]:
        """Return ½ log S and U: the weights are w = √S ⊙ (I − U Uᵀ) z, z ~ N(0, I); U is None unless conditioned."""
        if self.Psi.shape[1] == 0:
            return jnp.zeros(0), None
        log_S = log_spectral_density(KERNELS[self.kernel], self.frequency, hyper.amplitude, hyper.length_scale)
        # √S as exp(½ log S): S underflows, and the gradient of √0 is NaN
        if self.constraints is None:
            return 0.5 * log_S, None
        return 0.5 * log_S, constraint_directions(jnp.exp(0.5 * log_S), self.constraints)

    def weights(self, z: Weights, hyper: Hyperparameters) -> Weights:
        """Return the feature weights w of standardised ones z."""
        if z.size == 0:
            return z
        log_root, U = self.weight_prior(hyper)
        return jnp.exp(log_root) * (z if U is None else z - U @ (U.T @ z))

    def standardised(self, weight: Weights, hyper: Hyperparameters, fresh: Weights) -> Weights:
        """Return z of weights: `fresh` where they do not determine it, zero where a weight has next to no variance."""
        log_root, U = self.weight_prior(hyper)
        usable = log_root > math.log(1e-100)
        z = jnp.where(usable, weight * jnp.exp(-jnp.where(usable, log_root, 0.0)), 0.0)
        return z if U is None else z + U @ (U.T @ fresh)

    def remove_discrepancy(self, y: Float[Array, " n_row"], hyper: Hyperparameters) -> tuple[Regression, FeatureSolve]:
        """Integrate out the weights of f: return the regression left for θ, and what `draw_discrepancy` needs."""
        log_root, U = self.weight_prior(hyper)
        regression, solve = remove_features(self.Phi, self.Psi, self.gram, y, log_root, hyper.sigma, U)
        log_det = regression.log_det + 2 * self.n_obs * jnp.log(hyper.sigma) + self.log_det_R
        return regression._replace(log_det=log_det), solve

    def sample_discrepancy(self, key: Array, hyper: Hyperparameters) -> Float[Array, " n_row"]:
        """Draw f on the compressed rows from its prior."""
        return self.Psi @ self.weights(jax.random.normal(key, self.Psi.shape[1:]), hyper)

    def sampled_weights(self, hyper: Hyperparameters) -> Weights:
        """Sample standardised weights as the site `z`, and return the feature weights; neither where there is no f."""
        if not self.Psi.shape[1]:
            return jnp.zeros(0)
        z = site("z", dist.Normal(0.0, 1.0).expand(self.Psi.shape[1:]).to_event(1))
        return jnp.asarray(numpyro.deterministic("weight", self.weights(z, hyper)))

    def prior_discrepancy(self, key: Array, hyper: Hyperparameters) -> dict[str, Array]:
        """Draw the weights from their prior."""
        return self._named(self.weights(jax.random.normal(key, self.Psi.shape[1:]), hyper))

    def draw_discrepancy(self, key: Array, hyper: Hyperparameters, theta: Theta, solve: Any) -> dict[str, Array]:
        """Draw the weights from their posterior: z | θ, η, y ~ N(Z_y − Z_Φ θ, (L Lᵀ)⁻¹), with L and Z in `solve`."""
        L, Z = solve
        z = Z[:, -1] - Z[:, :-1] @ theta + solve_lower_transposed(L, jax.random.normal(key, L.shape[:1]))
        return self._named(self.weights(z, hyper))

    def at(self, frame: Frame, columns: Columns, draws: EquationDraws) -> Float[np.ndarray, "n_draw n_row"]:
        """Return Ψ̃ w at any rows."""
        return draws.weight @ np.asarray(frame.rows(columns)[1]).T

    def at_data(
        self, Psi: Float[np.ndarray, "n_obs n_basis"], index: Int[np.ndarray, " n_obs"] | slice, draws: EquationDraws
    ) -> Float[np.ndarray, "n_draw n_obs"]:
        """Return Ψ̃ w at rows of the data."""
        return draws.weight @ Psi.T

    def on_rows(
        self, weight: Float[np.ndarray, "*batch n_basis"], f: Float[np.ndarray, "*batch n_value"]
    ) -> Float[np.ndarray, "*batch n_row"]:
        """Return Ψ̃ w at the compressed rows."""
        return weight @ np.asarray(self.Psi).T

    def plain(self, frame: Frame) -> "FeatureDesign":
        """Return the rows with the features before the dictionary was projected out of them, unconstrained."""
        Psi = np.asarray(self.Psi)
        if frame.projected:
            Psi = Psi + np.asarray(self.Phi) @ frame.orthonormal @ frame.moments
        return replace(self, Psi=on_device(Psi), gram=on_device(Psi.T @ Psi), constraints=None)

    def weighted(self, rows: EquationRows, table: Table) -> PickRows:
        """Return a function from numbers of observations to R⁻¹[Φ Ψ̃ y] and diag R⁻¹ there."""
        values, precision = rows.weighted(table)
        n_term = self.Phi.shape[1]

        def pick(index: Numbers) -> WeightedRows:
            part = values(index)
            columns = (part[:, :n_term], part[:, n_term:-1], part[:, -1], precision(index)[:, 0])
            return WeightedRows(*on_device((index, *columns)))

        return pick

    def root(self, rows: WeightedRows, hyper: Hyperparameters, sd: Float[Array, " n_term"]) -> Root:
        """Return a `Root` with C⁻¹ = σ⁻² (R⁻¹ − HᵀH) for C = σ²(R + BBᵀ), B = [Φ sd, Ψ̃ √S (I − UUᵀ)]/σ.

        H = T⁻ᵀBᵀR⁻¹ by Woodbury's identity, with I + BᵀR⁻¹B = TᵀT from a QR factorisation, since the Gram matrix would
        square the condition number.
        """
        log_root, U = self.weight_prior(hyper)
        root = jnp.exp(log_root)

        def scaled(Phi: Array, Psi: Array) -> Array:
            B = Psi * root
            B = B if U is None else B - (B @ U) @ U.T
            return jnp.concatenate([Phi * sd, B], axis=1) / hyper.sigma

        # The compressed rows have the Gram matrix of the whitened ones.
        B = scaled(self.Phi, self.Psi)
        n_column = B.shape[1]
        with_target = jnp.column_stack([B, self.y / hyper.sigma])
        penalised = jnp.concatenate([with_target, jnp.eye(n_column, n_column + 1)], axis=0)
        triangle = jnp.linalg.qr(penalised, mode="r")
        T, right = triangle[:n_column, :n_column], triangle[:n_column, n_column]
        weighted = scaled(rows.Phi, rows.Psi)
        half = solve_triangular(T, weighted.T, trans=1)
        g = (rows.y / hyper.sigma - weighted @ solve_triangular(T, right)) / hyper.sigma
        return Root(half, g, solve_triangular(T, half)[: len(sd)] / hyper.sigma)

    def inverse(
        self, left: Float[Array, "n k"], right: Float[Array, "m k"], precision: Array, hyper: Hyperparameters
    ) -> Float[Array, "n m"]:
        """Return σ⁻² (R⁻¹ − HᵀH), blocks of C⁻¹ from columns H_i and H_j of `Root`, and blocks of R⁻¹."""
        return (precision - left @ right.T) / hyper.sigma**2

    def inverse_diagonal(self, root: Root, rows: WeightedRows, hyper: Hyperparameters) -> Float[Array, " n_row"]:
        """Return σ⁻² diag(R⁻¹ − HᵀH)."""
        return (rows.precision - jnp.sum(root.H**2, axis=0)) / hyper.sigma**2

    def removes(self, size: int) -> bool:
        """Return whether leaving out so many observations is cheaper by a new factor than by a block of C⁻¹."""
        return size > self.Phi.shape[1] + self.Psi.shape[1]

    def without(self, rows: EquationRows, table: Table, out: Numbers, removal: Removal) -> "FeatureDesign":
        """Return the factor of the whitened rows without the observations `out`; `removal` is `rows.without(out)`."""
        kept, directions = removal.kept, removal.directions
        white = rows.whitened(table)
        if directions is None:
            factor = triangular_factor(lambda index: white(kept[index]), len(kept))
        else:
            whole = white(np.arange(rows.n_white))
            left = whole - directions @ (directions.T @ whole)
            factor = triangular_factor(lambda index: left[index], len(left))
        n_term = self.Phi.shape[1]
        Phi, Psi, y = factor[:, :n_term], factor[:, n_term:-1], factor[:, -1]
        Phi, Psi, gram, y = map(jnp.asarray, (Phi, Psi, Psi.T @ Psi, y))
        numbers = {"n_obs": self.n_obs - len(out), "log_det_R": self.log_det_R + removal.log_det}
        return replace(self, Phi=Phi, Psi=Psi, gram=gram, y=y, **numbers)

    def padded(self) -> "FeatureDesign":
        """Fill a factor of few rows up with rows of zeros, which change nothing."""
        short = max(0, self.Phi.shape[1] + self.Psi.shape[1] + 1 - len(self.y))
        Phi, Psi, y = (np.pad(a, [(0, short), (0, 0)][: a.ndim]) for a in (self.Phi, self.Psi, self.y))
        return replace(self, Phi=jnp.asarray(Phi), Psi=jnp.asarray(Psi), y=jnp.asarray(y))

    def first_densities(
        self, order: Numbers, counts: Int[np.ndarray, " n_count"], parameters: tuple[Hyperparameters, Scales]
    ) -> Float[np.ndarray, "n_draw n_count"] | None:
        """Return None: each number of first rows has a factor of its own; see `DenseDesign.first_densities`."""
        return None

    def open(
        self, Phi: Float[np.ndarray, "n_white n_term"], Psi: Float[np.ndarray, "n_white n_basis"]
    ) -> tuple["FeatureDesign", Compress]:
        """Return the design for other targets, and a function that makes its targets of whitened ones.

        [Φ Ψ̃] = Q R: the sampler sees R, Qᵀy, and the norm of what Q cannot say as one more row.
        """
        rotation, R = np.linalg.qr(np.column_stack([Phi, Psi]))
        R = np.vstack([R, np.zeros((int(len(Phi) > R.shape[1]), R.shape[1]))])
        features = jnp.asarray(R[:, Phi.shape[1] :])

        def compress(y: Float[np.ndarray, "n_replicate n_white"]) -> Float[np.ndarray, "n_replicate n_row"]:
            kept = y @ rotation
            if rotation.shape[0] <= rotation.shape[1]:
                return kept
            # ‖y − QQᵀy‖ as a residual, not as a difference of squares
            return np.column_stack([kept, np.linalg.norm(y - kept @ rotation.T, axis=1)])

        design = replace(
            self, Phi=jnp.asarray(R[:, : Phi.shape[1]]), Psi=features, gram=features.T @ features, y=jnp.zeros(len(R))
        )
        return design, compress

    def simulate(
        self, hyper: Hyperparameters, Psi: Float[np.ndarray, "n_white n_basis"], generator: np.random.Generator
    ) -> tuple[dict[str, np.ndarray], Float[np.ndarray, "n_replicate n_white"]]:
        """Draw w ~ N(0, S), or given C w = 0, in plain NumPy; return it, if there is f, and f at the whitened rows."""
        if Psi.shape[1] == 0:
            return {}, np.zeros((len(hyper.sigma), len(Psi)))
        kernel = KERNELS[self.kernel]
        log_S = jax.vmap(lambda a, ell: log_spectral_density(kernel, self.frequency, a, ell))(
            jnp.asarray(hyper.amplitude), jnp.asarray(hyper.length_scale)
        )
        S = np.exp(np.asarray(log_S))
        weight = np.sqrt(S) * generator.standard_normal(S.shape)
        if self.constraints is not None:
            weight = _condition(weight, S, np.asarray(self.constraints))
        return {"weight": weight}, weight @ Psi.T

    def _named(self, weight: Array) -> dict[str, Array]:
        return {"weight": weight} if weight.size else {}


def _condition(
    weight: Float[np.ndarray, "n n_basis"], S: Float[np.ndarray, "n n_basis"], C: Float[np.ndarray, "n_rank n_basis"]
) -> Float[np.ndarray, "n n_basis"]:
    """Return draws of w given C w = 0 from free ones: w − S Cᵀ (C S Cᵀ)⁺ C w (Matheron's rule)."""
    out = np.empty_like(weight)
    for i, (w, s) in enumerate(zip(weight, S, strict=True)):
        # Least squares in standardised weights, so that C S Cᵀ is never formed.
        root = np.sqrt(s)
        z = w / np.where(root > 0, root, 1.0)
        out[i] = root * (z - np.linalg.pinv(C * root) @ (C @ w))
    return out
