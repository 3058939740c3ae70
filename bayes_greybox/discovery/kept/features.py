"""Features of a discrepancy, as files of older versions hold them of explanations: read, and not used."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.model.gp.features import HilbertBasis


@dataclass(frozen=True)
class Features:
    """Features of a discrepancy.

    Attributes:
        variables: Columns that f depends on.
        centre: Middle of their box in the data, user's units.
        half_width: Half its sides.
        basis: All features, on the box as [−1, 1]^d.
        kept: Numbers of those that an explanation has.
    """

    variables: tuple[str, ...]
    centre: Float[np.ndarray, " n_var"]
    half_width: Float[np.ndarray, " n_var"]
    basis: HilbertBasis
    kept: Int[np.ndarray, " n_feature"]
