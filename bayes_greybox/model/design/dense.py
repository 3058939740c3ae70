"""The exact path: f is in the model by its covariance matrix at the rows."""

from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bayes_greybox.model.algebra.collapsed import Regression, log_evidence
from bayes_greybox.model.algebra.linalg import singular_root, solve_lower
from bayes_greybox.model.frame import Frame
from bayes_greybox.model.gp.hyper import Hyperparameters
from bayes_greybox.model.gp.kernels import KERNELS, Points, Variant, orthogonal_gram
from bayes_greybox.model.priors import Scales
from bayes_greybox.model.rows.equation_rows import Columns, EquationRows, Removal, Table
from bayes_greybox.running.errors import InputError

from .protocol import Compress, DesignRows, EquationDraws, Numbers, PickRows, Root, Theta, WeightedRows, Weights


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DenseDesign(DesignRows):
    """Rows of one equation on the exact path.

    `points` are the variables of f and Φₒ at the samples, `nodes` those of the measure and w Φₒ there, `whitening` is W
    (None where rows are independent), and `operator` V (None where each sample is a row).
    """

    expands = False

    points: Points
    nodes: Points
    whitening: Float[Array, "n_row n_obs"] | None
    operator: Float[Array, "n_obs n_sample"] | None
    kernel: str = field(metadata={"static": True})
    variant: Variant = field(metadata={"static": True})

    @property
    def n_var(self) -> int:
        """Number of variables that f depends on."""
        return self.points[0].shape[1]

    def worthwhile(self, draws: int) -> int:
        """Return a number of draws that factorisations of all rows can be afforded for."""
        return min(draws, 100)

    def covariance(self, hyper: Hyperparameters) -> Float[Array, "n_row n_row"]:
        """Return k⊥ at the (whitened) rows."""
        return self._to_rows(self._to_rows(self.cross_covariance(self.points, hyper)).T)

    def cross_covariance(self, left: Points, hyper: Hyperparameters) -> Float[Array, "n_left n_sample"]:
        """Return k⊥ between other points and the samples of the data."""
        return self._gram(left, self.points, hyper)

    def remove_discrepancy(
        self, y: Float[Array, " n_row"], hyper: Hyperparameters
    ) -> tuple[Regression, Float[Array, "n_row n_row"]]:
        """Integrate out f ~ N(0, K⊥) at the rows: [T q] = L⁻¹ [Φ y], L Lᵀ = K⊥ + σ² I; also returns L."""
        K = self.covariance(hyper)
        L = jnp.linalg.cholesky(K + hyper.sigma**2 * jnp.eye(K.shape[0]))
        left = solve_lower(L, jnp.column_stack([self.Phi, y]))
        return Regression(left[:, :-1], left[:, -1], 2 * jnp.sum(jnp.log(jnp.diag(L))) + self.log_det_R), L

    def sample_discrepancy(self, key: Array, hyper: Hyperparameters) -> Float[Array, " n_row"]:
        """Draw f on the rows from its prior."""
        return singular_root(self.covariance(hyper)) @ jax.random.normal(key, self.y.shape)

    def sampled_weights(self, hyper: Hyperparameters) -> Weights:
        """Refuse: f has no weights."""
        raise InputError("f has no weights to sample: use OrthogonalGP(path='hsgp').")

    def standardised(self, weight: Weights, hyper: Hyperparameters, fresh: Weights) -> Weights:
        """Refuse: f has no weights."""
        return self.sampled_weights(hyper)

    def prior_discrepancy(self, key: Array, hyper: Hyperparameters) -> dict[str, Array]:
        """Draw f at the samples of the data from its prior."""
        covariance = self.cross_covariance(self.points, hyper)
        return {"f": singular_root(covariance) @ jax.random.normal(key, covariance.shape[:1])}

    def draw_discrepancy(self, key: Array, hyper: Hyperparameters, theta: Theta, solve: Any) -> dict[str, Array]:
        """Draw f at the samples of the data from its posterior."""
        return {"f": self._drawn(key, hyper, theta, self.points)}

    def at(self, frame: Frame, columns: Columns, draws: EquationDraws) -> Float[np.ndarray, "n_draw n_row"]:
        """Draw f at other points given θ and η, not given its values at the data."""
        left = (jnp.asarray(frame.position(columns)), jnp.asarray(frame.dictionary_rows(columns) @ frame.orthonormal))
        keys = jax.random.split(jax.random.PRNGKey(0), len(draws.theta))

        def one(item: tuple[Array, Hyperparameters, Array]) -> Array:
            key, hyper, theta = item
            return self._drawn(key, hyper, theta, left)

        hyper = Hyperparameters(*map(jnp.asarray, draws.hyper))
        return np.asarray(jax.lax.map(one, (keys, hyper, jnp.asarray(draws.theta))))

    def at_data(
        self, Psi: Float[np.ndarray, "n_obs n_basis"], index: Int[np.ndarray, " n_obs"] | slice, draws: EquationDraws
    ) -> Float[np.ndarray, "n_draw n_obs"]:
        """Return the values that were drawn there, or their means."""
        return (draws.f if self.operator is None else draws.f @ np.asarray(self.operator).T)[:, index]

    def on_rows(
        self, weight: Float[np.ndarray, "*batch n_basis"], f: Float[np.ndarray, "*batch n_value"]
    ) -> Float[np.ndarray, "*batch n_row"]:
        """Return the values that were drawn at the data as those of the whitened rows."""
        return np.asarray(self._to_rows(f))

    def plain(self, frame: Frame) -> "DenseDesign":
        """Return the rows with the base kernel."""
        return replace(self, variant="none")

    def weighted(self, rows: EquationRows, table: Table) -> PickRows:
        """Return the numbers of the observations alone: everything else is in C."""
        nothing = (jnp.zeros((0, self.Phi.shape[1])), jnp.zeros((0, 0)), jnp.zeros(0), jnp.zeros(0))
        return lambda index: WeightedRows(jnp.asarray(index), *nothing)

    def root(self, rows: WeightedRows, hyper: Hyperparameters, sd: Float[Array, " n_term"]) -> Root:
        """Return a `Root` with C⁻¹ = HᵀH = Wᵀ (W (ΦDΦᵀ + K⊥) Wᵀ + σ²I)⁻¹ W; W left out where not square."""
        Phi = self.Phi * sd
        L = jnp.linalg.cholesky(Phi @ Phi.T + self.covariance(hyper) + hyper.sigma**2 * jnp.eye(len(self.y)))
        W = self.whitening
        half = solve_lower(L, jnp.eye(len(L)) if W is None or W.shape[0] != W.shape[1] else W)
        g, J = half.T @ solve_lower(L, self.y), solve_lower(L, Phi).T @ half
        return Root(half[:, rows.number], g[rows.number], J[:, rows.number])

    def inverse(
        self, left: Float[Array, "n k"], right: Float[Array, "m k"], precision: Array, hyper: Hyperparameters
    ) -> Float[Array, "n m"]:
        """Return HᵀH: the noise is in it."""
        return left @ right.T

    def inverse_diagonal(self, root: Root, rows: WeightedRows, hyper: Hyperparameters) -> Float[Array, " n_row"]:
        """Return diag HᵀH."""
        return jnp.sum(root.H**2, axis=0)

    def removes(self, size: int) -> bool:
        """Return False: C is factorised anyway."""
        return False

    def without(self, rows: EquationRows, table: Table, out: Numbers, removal: Removal) -> "DenseDesign":
        """Rotate the rows into an orthonormal basis of what is left: of unit vectors, if nothing is correlated."""
        remain = np.eye(rows.n_white)[removal.kept]
        if removal.directions is not None:
            remain = np.linalg.qr(removal.directions, mode="complete")[0][:, len(out) :].T
        W = remain if self.whitening is None else remain @ np.asarray(self.whitening)
        Phi, y = (jnp.asarray(remain @ np.asarray(each)) for each in (self.Phi, self.y))
        numbers = {"n_obs": self.n_obs - len(out), "log_det_R": self.log_det_R + removal.log_det}
        return replace(self, Phi=Phi, y=y, whitening=jnp.asarray(W), **numbers)

    def padded(self) -> "DenseDesign":
        """Return the design itself: its covariance matrix is as large as it has rows."""
        return self

    def first_densities(
        self, order: Numbers, counts: Int[np.ndarray, " n_count"], parameters: tuple[Hyperparameters, Scales]
    ) -> Float[np.ndarray, "n_draw n_count"]:
        """Return log p(y_A | η) of the first rows A in an order, for increasing numbers of them, without log|R_AA|.

        One Cholesky factorisation of K⊥ + σ²R in this order serves them all. `parameters` are stacked over draws.
        """
        return np.asarray(_first_densities(self, jnp.asarray(order), jnp.asarray(counts), parameters))

    def open(
        self, Phi: Float[np.ndarray, "n_white n_term"], Psi: Float[np.ndarray, "n_white n_basis"]
    ) -> tuple["DenseDesign", Compress]:
        """Return the design itself: its rows are the whitened ones."""
        return self, lambda y: y

    def simulate(
        self, hyper: Hyperparameters, Psi: Float[np.ndarray, "n_white n_basis"], generator: np.random.Generator
    ) -> tuple[dict[str, np.ndarray], Float[np.ndarray, "n_replicate n_white"]]:
        """Draw f ~ N(0, K⊥) at the samples of the data, through eigenvalues."""
        covariance = jax.jit(lambda hyper: self.cross_covariance(self.points, hyper))
        f = np.empty((len(hyper.sigma), len(self.points[0])))
        for i in range(len(f)):
            one = Hyperparameters(*(jnp.asarray(part[i]) for part in hyper))
            values, vectors = np.linalg.eigh(np.asarray(covariance(one)))
            f[i] = vectors @ (np.sqrt(np.maximum(values, 0.0)) * generator.standard_normal(len(values)))
        return {"f": f}, np.asarray(self._to_rows(f))

    def _gram(self, left: Points, right: Points, hyper: Hyperparameters) -> Array:
        kernel = KERNELS[self.kernel]
        return orthogonal_gram(self.variant, kernel, hyper.amplitude, hyper.length_scale, left, right, self.nodes)

    def _to_rows(self, values: Float[Array | np.ndarray, "*batch n_sample"]) -> Float[Array, "*batch n_row"]:
        """Return W V times values at the samples."""
        at_rows = jnp.asarray(values)
        for matrix in (self.operator, self.whitening):
            at_rows = at_rows if matrix is None else at_rows @ matrix.T
        return at_rows

    def _drawn(self, key: Array, hyper: Hyperparameters, theta: Theta, left: Points) -> Float[Array, " n_left"]:
        """Draw f | θ ~ N(k* C⁻¹ (y − Φθ), k** − k* C⁻¹ k*ᵀ), C = K⊥ + σ² I."""
        _, L = self.remove_discrepancy(self.y, hyper)
        cross = self._to_rows(self.cross_covariance(left, hyper))
        half = solve_lower(L, cross.T)
        mean = half.T @ solve_lower(L, self.y - self.Phi @ theta)
        covariance = self._gram(left, left, hyper) - half.T @ half
        return mean + singular_root(covariance) @ jax.random.normal(key, mean.shape)


@jax.jit
def _first_densities(
    design: DenseDesign, order: Array, counts: Array, parameters: tuple[Hyperparameters, Scales]
) -> Array:
    def one(item: tuple[Hyperparameters, Scales]) -> Array:
        hyper, scales = item
        C = design.covariance(hyper) + hyper.sigma**2 * jnp.eye(len(design.y))
        L = jnp.linalg.cholesky(C[order[:, None], order])
        left = solve_lower(L, jnp.column_stack([design.Phi, design.y])[order])
        log_det = jnp.concatenate([jnp.zeros(1), 2 * jnp.cumsum(jnp.log(jnp.diag(L)))])

        def first(count: Array) -> Array:
            # L is triangular: what f leaves of the first rows does not know the later ones.
            first_rows = jnp.where((jnp.arange(len(order)) < count)[:, None], left, 0.0)
            regression = Regression(first_rows[:, :-1], first_rows[:, -1], log_det[count]).beside(scales.mean)
            return log_evidence(regression, scales.sd, scales.log_odds, 1.0 * count, design.coefficients.certain)

        return jax.lax.map(first, counts)

    return jax.lax.map(one, parameters)
