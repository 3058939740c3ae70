"""The interface of designs: remove f, draw f, evaluate f elsewhere, leave rows out. Nobody asks which kind it is."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Array, Float, Int

from bayes_greybox.model.algebra.collapsed import Regression
from bayes_greybox.model.coefficient_priors import CoefficientPriors
from bayes_greybox.model.frame import Frame
from bayes_greybox.model.gp.hyper import Hyperparameters
from bayes_greybox.model.priors import Scales
from bayes_greybox.model.rows.equation_rows import EquationRows, Removal, Table

Compress = Callable[[Float[np.ndarray, "n_replicate n_white"]], Float[np.ndarray, "n_replicate n_row"]]
"""Function from whitened targets to those of a design."""


class EquationDraws(NamedTuple):
    """Posterior draws of one equation in scaled units, chains flattened: what the mathematics works with.

    Attributes:
        hyper: Noise SD [n_draw], amplitude [n_draw] and length scales [n_draw, n_var].
        theta: Coefficients.
        prior_sd: Prior standard deviation of each coefficient, zero where it is out.
        weight: Feature weights; no columns where f is not made of features.
        f: Values of f at the rows of the data; no columns where weights determine it.
        mean: Mean of θ given the draw's η, pattern and coefficients with bounds, under which the target is normal. The
            latter stay at their draws, the others have their prior mean.
        spread: Standard deviation of θ given the same: `prior_sd`, and zero where a coefficient has bounds.
    """

    hyper: Hyperparameters
    theta: Float[np.ndarray, "n_draw n_term"]
    prior_sd: Float[np.ndarray, "n_draw n_term"]
    weight: Float[np.ndarray, "n_draw n_basis"]
    f: Float[np.ndarray, "n_draw n_value"]
    mean: Float[np.ndarray, "n_draw n_term"]
    spread: Float[np.ndarray, "n_draw n_term"]


class WeightedRows(NamedTuple):
    """Observations weighted by the inverse noise correlation, R⁻¹[Φ Ψ̃ y], and diag R⁻¹, in scaled units.

    Where W is not square they are W[Φ Ψ̃ y] and ones: whitened coefficients, which are independent. A design that keeps
    C whole needs their numbers only; the other fields are empty then.
    """

    number: Int[Array, " n_row"]
    Phi: Float[Array, "n_some n_term"]
    Psi: Float[Array, "n_some n_basis"]
    y: Float[Array, " n_some"]
    precision: Float[Array, " n_some"]

    def beside(self, theta: Float[Array, " n_term"]) -> "WeightedRows":
        """Return the same with Φθ taken off the target."""
        return self._replace(y=self.y - self.Phi @ theta)


class Root(NamedTuple):
    """H, see `Design.inverse`, g = C⁻¹y and J = cov(u, y) C⁻¹ at some observations, with θ = sd · u, u ~ N(0, I)."""

    H: Float[Array, "n_left n_row"]
    g: Float[Array, " n_row"]
    J: Float[Array, "n_term n_row"]


@dataclass(frozen=True)
class Design(ABC):
    """Rows of one equation as the likelihood sees them, whitened and in scaled units; a pytree of arrays.

    Arguments of the methods have the same meaning throughout: `hyper` is η, `theta` the coefficients, `frame` the
    scaling and bases of the equation, `rows` its rows, `table` [Φ Ψ̃ y] at rows of the data in scaled units, `draws`
    posterior draws and `Psi` orthogonal features.

    Attributes:
        Phi: Dictionary.
        y: Target.
        n_obs: Number of measurements behind the rows.
        n_prior: Number of rows for a prior that asks for it: leaving rows out must not change the prior.
        log_det_R: log|R|.
        noise_floor: Least σ.
        coefficients: Priors of single terms.
        expands: If true, f is a finite sum of features, so that it has a value at every state an integrator visits.
    """

    Phi: Float[Array, "n_row n_term"]
    y: Float[Array, " n_row"]
    n_obs: Float[Array, ""]
    n_prior: Float[Array, ""]
    log_det_R: Float[Array, ""]
    noise_floor: Float[Array, ""]
    coefficients: CoefficientPriors

    expands: ClassVar[bool]

    @property
    @abstractmethod
    def n_var(self) -> int:
        """Number of variables that f depends on."""

    def worthwhile(self, draws: int) -> int:
        """Return how many of so many posterior draws are worth their cost."""
        return draws

    @abstractmethod
    def remove_discrepancy(self, y: Float[Array, " n_row"], hyper: Hyperparameters) -> tuple[Regression, Any]:
        """Integrate out f: return the regression left for θ, and what `draw_discrepancy` needs."""

    @abstractmethod
    def sample_discrepancy(self, key: Array, hyper: Hyperparameters) -> Float[Array, " n_row"]:
        """Draw f on the design's rows from its prior."""

    @abstractmethod
    def sampled_weights(self, hyper: Hyperparameters) -> Float[Array, " n_basis"]:
        """Return weights of f from sites of a NumPyro model.

        Raises:
            InputError: The design has no such sites.
        """

    @abstractmethod
    def standardised(
        self, weight: Float[Array, " n_basis"], hyper: Hyperparameters, fresh: Float[Array, " n_basis"]
    ) -> Float[Array, " n_basis"]:
        """Return the standardised weights that `sampled_weights` makes these weights of.

        Standard normal numbers `fresh` take the place of what the weights do not determine.

        Raises:
            InputError: The design has no weights.
        """

    @abstractmethod
    def prior_discrepancy(self, key: Array, hyper: Hyperparameters) -> dict[str, Array]:
        """Draw f from its prior, by quantity, `weight` or `f`; empty without a discrepancy."""

    @abstractmethod
    def draw_discrepancy(
        self, key: Array, hyper: Hyperparameters, theta: Float[Array, " n_term"], solve: Any
    ) -> dict[str, Array]:
        """Draw f from its posterior given θ, by quantity; `solve` is from `remove_discrepancy`."""

    @abstractmethod
    def at(
        self, frame: Frame, columns: Mapping[str, np.ndarray], draws: EquationDraws
    ) -> Float[np.ndarray, "n_draw n_row"]:
        """Return posterior draws of f at any rows, scaled units; `columns` are states and inputs there."""

    @abstractmethod
    def at_data(
        self, Psi: Float[np.ndarray, "n_obs n_basis"], index: Int[np.ndarray, " n_obs"] | slice, draws: EquationDraws
    ) -> Float[np.ndarray, "n_draw n_obs"]:
        """Return posterior draws of f at rows of the data with these numbers, scaled units, not whitened."""

    @abstractmethod
    def on_rows(
        self, weight: Float[np.ndarray, "*batch n_basis"], f: Float[np.ndarray, "*batch n_value"]
    ) -> Float[np.ndarray, "*batch n_row"]:
        """Return draws of f on the design's rows.

        Args:
            weight: Its weights; no columns where f is not made of features.
            f: Its values at the rows of the data; no columns where weights determine it.
        """

    def with_target(self: "AnyDesign", y: Float[Array, " n_row"]) -> "AnyDesign":
        """Return the same rows with another target."""
        return replace(self, y=y)

    def beside(self: "AnyDesign", theta: Float[Array, " n_term"]) -> "AnyDesign":
        """Return the same rows with Φθ taken off the target."""
        return self.with_target(self.y - self.Phi @ theta)

    @abstractmethod
    def plain(self, frame: Frame) -> "Design":
        """Return the same rows with the kernel `none`, which is not orthogonal to the dictionary."""

    @abstractmethod
    def weighted(
        self, frame: Frame, rows: EquationRows, table: Table
    ) -> Callable[[Int[np.ndarray, " n"]], WeightedRows]:
        """Return a function from numbers of observations to their rows, as `root` wants them."""

    @abstractmethod
    def root(self, rows: WeightedRows, hyper: Hyperparameters, sd: Float[Array, " n_term"]) -> Root:
        """Return the `Root` at some observations, of C = ΦDΦᵀ + K⊥ + σ²R, D = diag(sd²)."""

    @abstractmethod
    def inverse(
        self, left: Float[Array, "n k"], right: Float[Array, "m k"], precision: Array, hyper: Hyperparameters
    ) -> Float[Array, "n m"]:
        """Return (C⁻¹)_ij from the columns H_i and H_j of `Root` and (R⁻¹)_ij."""

    @abstractmethod
    def inverse_diagonal(self, root: Root, rows: WeightedRows, hyper: Hyperparameters) -> Float[Array, " n_row"]:
        """Return the diagonal of C⁻¹ at the observations of a root."""

    @abstractmethod
    def removes(self, size: int) -> bool:
        """Return whether so many observations are better left out by a design without them than by a block of C⁻¹."""

    @abstractmethod
    def without(
        self, frame: Frame, rows: EquationRows, table: Table, out: Int[np.ndarray, " n_out"], removal: Removal
    ) -> "Design":
        """Return the design without the targets of the observations `out`; `removal` is `rows.without(out)`."""

    def padded(self) -> "Design":
        """Return the same likelihood from arrays of a shape that does not depend on how many rows were left out."""
        return self

    def first_densities(
        self, order: Int[np.ndarray, " n_obs"], counts: Int[np.ndarray, " n_count"],
        parameters: tuple[Hyperparameters, Scales],
    ) -> Float[np.ndarray, "n_draw n_count"] | None:  # fmt: skip
        """Return log p(y_A | η) of the first rows A in an order, for several numbers of them, without log|R_AA|.

        None where there is no closed form that serves all of them at once.

        Args:
            order: Rows.
            counts: Numbers of rows in A, in increasing order.
            parameters: η and the scales of θ, stacked over draws.
        """
        return None

    @abstractmethod
    def open(
        self, Phi: Float[np.ndarray, "n_white n_term"], Psi: Float[np.ndarray, "n_white n_basis"]
    ) -> tuple["Design", Compress]:
        """Return the design for targets other than the measured one, and what makes its targets of whitened ones.

        Args:
            Phi: Whitened dictionary.
            Psi: Whitened orthogonal features.
        """

    @abstractmethod
    def simulate(
        self, hyper: Hyperparameters, Psi: Float[np.ndarray, "n_white n_basis"], generator: np.random.Generator
    ) -> tuple[dict[str, np.ndarray], Float[np.ndarray, "n_replicate n_white"]]:
        """Draw f from its prior in plain NumPy, for simulation-based calibration, sharing no code with the likelihood.

        Args:
            hyper: η of each replicate.
            Psi: Whitened orthogonal features.
            generator: Source of randomness.

        Returns:
            The draws by quantity, `weight` or `f` (empty without a discrepancy), and f at the whitened rows.
        """


AnyDesign = TypeVar("AnyDesign", bound=Design)
"""A `Design` of whatever class."""
