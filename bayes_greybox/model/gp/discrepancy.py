"""The user's choice of Gaussian process for what the dictionary cannot say."""

from dataclasses import dataclass
from operator import index
from typing import Annotated, Any, Literal

from bayes_greybox.running.errors import InputError
from bayes_greybox.running.limits import Count, OneOf, Positive, Rule, Seed, require_limits

from .kernels import KERNELS, Measure, Variant

Path = Literal["hsgp", "exact"]

EXACT_LIMIT = 1500
"""Most rows that the dense path is offered for."""

# No data tell 10,000 features along a variable apart, and a number without end asks for all memory.
FEATURE_COUNTS = Rule(
    lambda features: all(type(count) is int and 0 < count <= 10_000 for count in _each(features)),
    "should be a positive whole number, or a list with one for each variable, of at most 10,000",
)

OUTSIDE_DATA = Rule(
    lambda boundary: all(isinstance(one, int | float) and one > 1 for one in _each(boundary)),
    "must exceed 1, the edge of the data",
)


@dataclass(frozen=True)
class OrthogonalGP:
    """f ~ GP(0, k⊥): a discrepancy that cannot take what the dictionary explains.

    Lengths are in half-widths of the data's box and amplitudes in RMS of the target, so the defaults suit any
    units: ℓ ~ LogNormal(log `length_scale`, `length_scale_spread`), amplitude ~ HalfNormal(`amplitude`).

    Attributes:
        variant: "projected" (default), "conditioned", "none", or "printed" (the seed paper's formula, which
            is no covariance for most hyperparameters; exact path only).
        measure: Measure of orthogonality: "empirical" (the training states, where their rates have
            correlated noise weighted by its inverse correlation as in the likelihood), "unweighted" (the training
            states whatever that noise, as in fits of earlier versions), "box" (uniform over their bounding box) or
            "box-monte-carlo" (the same by `monte_carlo` random points, as in the paper).
        kernel: One of `kernels.KERNELS`: "squared_exponential", "matern32" or "matern52", with one length scale per
            variable.
        path: "hsgp" (Hilbert-space features, cost independent of the number of rows) or "exact" (dense).
        variables: Variables that f depends on; None: every state and input.
        features: Features per variable on the hsgp path; None: 20, 10², 8 by total order for 1, 2, 3
            variables.
        boundary: Half-width of the features' domain over that of the data, or one for each variable; where `features`
            are left to the package, a fit is repeated on a wider one if the posterior is sure of length scales that
            this cannot hold.
        length_scale: Prior median of the length scales.
        length_scale_spread: Prior standard deviation of their logarithm.
        amplitude: Prior scale of the standard deviation of f.
        monte_carlo: Points for "box-monte-carlo".
        seed: Seed of these points.
    """

    variant: Variant = "projected"
    measure: Measure = "empirical"
    kernel: Annotated[str, OneOf(KERNELS)] = "squared_exponential"
    path: Path = "hsgp"
    variables: tuple[str, ...] | None = None
    features: Annotated[int | tuple[int, ...] | None, FEATURE_COUNTS] = None
    boundary: Annotated[float | tuple[float, ...], OUTSIDE_DATA] = 2.0
    length_scale: Positive = 1.0
    length_scale_spread: Positive = 0.5
    amplitude: Positive = 1.0
    monte_carlo: Count = 2000
    seed: Seed = 0

    def __post_init__(self) -> None:
        if isinstance(self.variables, str) or (self.variables is not None and len(self.variables) == 0):
            raise InputError(
                f"OrthogonalGP(variables={self.variables!r}) must name one variable or more, such as "
                "variables=('y', 'ydot'); leave it out for all states and inputs."
            )
        for name in ("variables", "boundary"):
            if isinstance(getattr(self, name), list):
                object.__setattr__(self, name, tuple(getattr(self, name)))
        if self.features is not None:
            object.__setattr__(self, "features", _whole(self.features))
        require_limits(self)
        if self.variant == "printed" and self.path != "exact":
            raise InputError(
                "OrthogonalGP(variant='printed') has no feature expansion, because it is not a covariance: "
                "give path='exact' to build it anyway, or use variant='projected'."
            )


def _each(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else [value]


def _whole(features: Any) -> int | tuple[int, ...]:
    try:
        return tuple(map(index, features)) if isinstance(features, list | tuple) else index(features)
    except TypeError as error:
        raise InputError(f"OrthogonalGP(features={features!r}) must be whole numbers.") from error
