"""Coverage of the true f by its posterior band: at the data, elsewhere in their box, and beyond it."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from scipy.stats import qmc

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.sampler.prior_data import OpenEquation
from bayes_greybox.model.frame import Frame, box_of
from bayes_greybox.model.sites import EquationSites, Sites

from .ranks import rank_truths

REGIONS, COVERAGE_LEVELS = ("data", "box", "beyond"), (0.5, 0.9)
PLACES_PER_REGION, CANDIDATES = 12, 512

BEYOND_REACH, LEAST_DISTANCE = 1.3, 0.1
"""Outer limit of the region "beyond", and distance to every row from which on a place is away from the data, both in
half-widths of the box."""


@dataclass(frozen=True)
class Places:
    """Places at which the band of f is compared with the truth: index in REGIONS, orthogonal features, row of the data.

    The row is −1 away from the data; on the exact path there are no features and no such places.
    """

    region: Int[np.ndarray, " n_place"]
    Psi: Float[np.ndarray, "n_place n_basis"]
    row: Int[np.ndarray, " n_place"]


def places(frame: Frame, data: Trajectories) -> Places:
    """Return rows spread evenly over the data, and quasi-random places away from them inside and outside their box.

    Places where a term is not finite are left out. On the exact path f is drawn at the rows only, so the other
    regions have no places.
    """
    row = np.unique(np.linspace(0, data.n_obs - 1, PLACES_PER_REGION + 2).round().astype(int)[1:-1])
    chosen = {name: column[row] for name, column in data.columns.items()}
    region = np.zeros(len(row), int)
    if frame.basis is not None:
        centre, half_width = box_of(data.columns, data.columns)
        unit = 2 * qmc.Halton(len(centre), scramble=False).random(CANDIDATES + 1)[1:] - 1
        candidates = dict(zip(data.columns, (centre + BEYOND_REACH * half_width * unit).T, strict=True))
        beyond = np.any(np.abs(BEYOND_REACH * unit[:, half_width > 0]) > 1, axis=1)
        at, rows = np.asarray(frame.position(candidates)), np.asarray(frame.position(data.columns))
        away = np.array([np.linalg.norm(rows - place, axis=1).min() > LEAST_DISTANCE for place in at])
        with np.errstate(all="ignore"):
            finite = np.all(np.isfinite(np.asarray(frame.dictionary_rows(candidates))), axis=1)
        outside = ~np.asarray(frame.inside(candidates))
        index = [np.flatnonzero(each & finite)[:PLACES_PER_REGION] for each in (~beyond & away, beyond & outside)]
        region, off = np.repeat([0, 1, 2], [len(row), *map(len, index)]), np.concatenate(index)
        chosen = {name: np.concatenate([column, candidates[name][off]]) for name, column in chosen.items()}
        row = np.concatenate([row, np.full(len(off), -1)])
    return Places(region, np.asarray(frame.rows(chosen)[1]), row)


def f_at(where: Places, values: Mapping[str, np.ndarray], own: EquationSites, index: int) -> np.ndarray:
    """Return f at the place of a number, from truths [n_replicate] or draws [n_replicate, n_draw]."""
    if where.Psi.shape[1] == 0:
        return values[own.f][..., where.row[index]]
    return values[own.weight] @ where.Psi[index]


def coverage_table(
    equations: Mapping[str, OpenEquation], where: Mapping[str, Places], truths: Mapping[str, np.ndarray],
    samples: Mapping[str, np.ndarray], generator: np.random.Generator,
) -> pd.DataFrame:  # fmt: skip
    """Return the share of replicates and places whose true f lies in the central band of the thinned posterior.

    Returns:
        A table by (equation, region, level) with coverage, its standard error (over replicates, as the places of one
        are not independent) and the number of places.
    """
    rows, names = {}, Sites(equations)
    for name, part in equations.items():
        if not part.equation.frame.variables:
            continue
        own, place = names[name], where[name]
        pit = [
            rank_truths(f_at(place, truths, own, i), f_at(place, samples, own, i), generator).pit
            for i in range(len(place.region))
        ]
        distance = np.abs(2 * np.column_stack(pit) - 1)
        for number, level in itertools.product(np.unique(place.region), COVERAGE_LEVELS):
            chosen = place.region == number
            # Replicates are independent, places are not.
            share = np.mean(distance[:, chosen] <= level, axis=1)
            error = share.std(ddof=1) / np.sqrt(len(share))
            rows[name, REGIONS[number], level] = (share.mean(), error, int(chosen.sum()))
    index = pd.MultiIndex.from_tuples(rows, names=["equation", "region", "level"]) if rows else None
    return pd.DataFrame(list(rows.values()), columns=["coverage", "se", "places"], index=index)
