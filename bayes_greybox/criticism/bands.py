"""Bands: mean, standard deviation and interval of posterior draws at many rows."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Band:
    """A predicted quantity at n rows: posterior mean, standard deviation and equal-tailed interval."""

    mean: Float[np.ndarray, " n_obs"]
    sd: Float[np.ndarray, " n_obs"]
    lower: Float[np.ndarray, " n_obs"]
    upper: Float[np.ndarray, " n_obs"]

    @classmethod
    def of(cls, draws: Float[np.ndarray, "n_draw n_obs"], level: float) -> "Band":
        """Summarise draws."""
        tail = (1 - level) / 2
        lower, upper = np.quantile(draws, [tail, 1 - tail], axis=0)
        return cls(draws.mean(axis=0), draws.std(axis=0), lower, upper)

    @classmethod
    def surviving(cls, draws: Float[np.ndarray, "n_draw n_obs"], level: float) -> "Band":
        """Summarise the finite draws of each row; NaN where there are none."""
        bands = np.full((4, draws.shape[1]), np.nan)
        finite = np.isfinite(draws)
        # Draws end one by one, so there are few different sets of finite ones: one call of quantile for each.
        sets, which = np.unique(np.packbits(finite, axis=0), axis=1, return_inverse=True)
        for i in range(sets.shape[1]):
            rows = np.flatnonzero(which.ravel() == i)
            alive = finite[:, rows[0]]
            if alive.any():
                bands[:, rows] = list(vars(cls.of(draws[np.ix_(alive, rows)], level)).values())
        return cls(*bands)

    @classmethod
    def join(cls, parts: "list[Band]") -> "Band":
        """Join the bands of consecutive rows."""
        return cls(*map(np.concatenate, zip(*(vars(part).values() for part in parts), strict=True)))


def band_holds(level: float, sources: Mapping[str, bool]) -> str:
    """Return a legend of a band with the sources of uncertainty in it; "" if there are none."""
    named = [name for name, inside in sources.items() if inside]
    return f"{level * 100:.3g} % band: {', '.join(named)}" if named else ""


def band_sources(holds: str) -> str:
    """Return the sources of uncertainty in a band, separated by commas, from what `band_holds` returned."""
    return holds.partition(": ")[2]
