"""Does the posterior band of f hold the true f: at the data, elsewhere in their box, and beyond it?"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from scipy.stats import qmc

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.sampler.prior_data import OpenEquation
from bayes_greybox.model.frame import Frame
from bayes_greybox.model.sites import EquationSites, Sites

from .ranks import rank_truths

REGIONS = ("data", "box", "beyond")
LEVELS = (0.5, 0.9)
POINTS = 12
"""Places in each region."""

CANDIDATES = 512
REACH = 1.3
"""How far out "beyond" goes, in half-widths of the box."""

AWAY = 0.1
"""A place this far from every row, in half-widths of the box, is away from the data."""


@dataclass(frozen=True)
class Places:
    """Where the band of f is looked at.

    Attributes:
        region: Number of the region of each place, an index into REGIONS.
        Psi: Orthogonal features there; no columns on the exact path.
        row: Row of the data that each place is; on the exact path there are no other places.
    """

    region: Int[np.ndarray, " n_place"]
    Psi: Float[np.ndarray, "n_place n_basis"]
    row: Int[np.ndarray, " n_place"]

    def first(self) -> Iterator[tuple[str, int]]:
        """The name of each region that has places, and its first place."""
        for number, name in enumerate(REGIONS):
            found = np.flatnonzero(self.region == number)
            if len(found):
                yield name, int(found[0])


def places(frame: Frame, data: Trajectories) -> Places:
    """Rows spread evenly over the data, and quasi-random places away from them inside and outside their box.

    Places where a term is not finite are left out. On the exact path f is drawn at the rows only, so the other
    regions have no places.

    Args:
        frame: Frame of the equation.
        data: Its data.
    """
    row = np.unique(np.linspace(0, data.n_obs - 1, POINTS + 2).round().astype(int)[1:-1])
    chosen = {name: column[row] for name, column in data.columns.items()}
    region = np.zeros(len(row), int)
    if frame.basis is not None:
        low = np.array([column.min() for column in data.columns.values()])
        high = np.array([column.max() for column in data.columns.values()])
        unit = 2 * qmc.Halton(len(low), scramble=False).random(CANDIDATES + 1)[1:] - 1
        candidates = dict(zip(data.columns, ((low + high) / 2 + REACH * (high - low) / 2 * unit).T, strict=True))
        beyond = np.any(np.abs(REACH * unit[:, high > low]) > 1, axis=1)
        at, rows = np.asarray(frame.position(candidates)), np.asarray(frame.position(data.columns))
        away = np.array([np.linalg.norm(rows - place, axis=1).min() > AWAY for place in at])
        with np.errstate(all="ignore"):
            finite = np.all(np.isfinite(np.asarray(frame.dictionary_rows(candidates))), axis=1)
        outside = ~np.asarray(frame.inside(candidates))
        for number, of in ((1, ~beyond & away), (2, beyond & outside)):
            found = np.flatnonzero(of & finite)[:POINTS]
            region = np.concatenate([region, np.full(len(found), number)])
            chosen = {name: np.concatenate([column, candidates[name][found]]) for name, column in chosen.items()}
            row = np.concatenate([row, np.full(len(found), -1)])
    return Places(region, np.asarray(frame.rows(chosen)[1]), row)


def f_at(where: Places, values: Mapping[str, np.ndarray], own: EquationSites, index: int) -> np.ndarray:
    """F at one place, from truths [n_replicate] or draws [n_replicate, n_draw].

    Args:
        where: Places.
        values: With the equation's weights, or values of f.
        own: Names of the equation's variables.
        index: Number of the place.
    """
    if where.Psi.shape[1] == 0:
        return values[own.f][..., where.row[index]]
    return values[own.weight] @ where.Psi[index]


def coverage_table(
    equations: Mapping[str, tuple[OpenEquation, Places]],
    truths: Mapping[str, np.ndarray],
    samples: Mapping[str, np.ndarray],
    generator: np.random.Generator,
) -> pd.DataFrame:
    """Share of replicates and places whose true f lies in the central band of the thinned posterior.

    Args:
        equations: Equations and places by name.
        truths: True values.
        samples: Posterior draws.
        generator: Source of random ranks.

    Returns:
        A table by (equation, region, level) with coverage, its standard error (over replicates: places of one are
        not independent) and the number of places.
    """
    found, names = {}, Sites(equations)
    for name, (part, where) in equations.items():
        if not part.equation.frame.variables:
            continue
        at = [
            rank_truths(f_at(where, truths, names[name], i), f_at(where, samples, names[name], i), generator).pit
            for i in range(len(where.region))
        ]
        distance = np.abs(2 * np.column_stack(at) - 1)
        for number, region in enumerate(REGIONS):
            chosen = where.region == number
            if not chosen.any():
                continue
            for level in LEVELS:
                # The share of the places of each replicate; replicates are independent, places are not.
                share = np.mean(distance[:, chosen] <= level, axis=1)
                error = share.std(ddof=1) / np.sqrt(len(share))
                found[name, region, level] = (share.mean(), error, int(chosen.sum()))
    index = pd.MultiIndex.from_tuples(found, names=["equation", "region", "level"]) if found else None
    return pd.DataFrame(list(found.values()), columns=["coverage", "se", "places"], index=index)
