"""What posterior draws say of a quantity at many rows: mean, standard deviation and interval."""

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
        """Summarise draws that may end in NaN: of those that have not yet, and NaN once all have."""
        found = {field: np.full(draws.shape[1], np.nan) for field in ("mean", "sd", "lower", "upper")}
        left = np.isfinite(draws)
        # Runs end one by one, so few different sets of draws are left: one call of quantile for each.
        sets, which = np.unique(np.packbits(left, axis=0), axis=1, return_inverse=True)
        for i in range(sets.shape[1]):
            rows = np.flatnonzero(which.ravel() == i)
            alive = left[:, rows[0]]
            if alive.any():
                band = cls.of(draws[np.ix_(alive, rows)], level)
                for field, values in found.items():
                    values[rows] = getattr(band, field)
        return cls(**found)

    @classmethod
    def join(cls, parts: "list[Band]") -> "Band":
        """Bands of consecutive rows as one."""
        return cls(*(np.concatenate([getattr(p, f) for p in parts]) for f in ("mean", "sd", "lower", "upper")))


def band_holds(level: float, sources: Mapping[str, bool]) -> str:
    """What a band holds, in words, for its legend; "" where nothing varies.

    Args:
        level: Probability of the band.
        sources: Sources of uncertainty, in order, and whether each is in it.
    """
    named = [name for name, inside in sources.items() if inside]
    return f"{level * 100:.3g} % band: {', '.join(named)}" if named else ""


def band_sources(holds: str) -> str:
    """Return the sources of uncertainty in a band, separated by commas, from what `band_holds` returned."""
    return holds.partition(": ")[2]
