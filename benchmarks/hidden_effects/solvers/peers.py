"""The way of a user today: PySINDy's sparse regression of the gap on the same terms.

Columns are the simulation's own terms, whose coefficients may be off, and every effect of the catalogue that the
study weighs too, with a few values of a nonlinear parameter. Columns and gap are scaled to unit RMS; the threshold is
chosen by leaving out blocks of neighbouring rows, the largest within one standard error of the best. Terms that are
kept are what the method names.
"""

import importlib
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_greybox.running.errors import InputError
from benchmarks.hidden_effects.cases import HiddenCase
from benchmarks.hidden_effects.generate import CaseData
from benchmarks.hidden_effects.systems.trajectories import rms

from .oracle import candidates, effect_values, inner_nodes, own_terms

THRESHOLDS = np.append(np.geomspace(0.01, 10.0, 16), 1e6)
"""Thresholds tried, in units of the gap's RMS; collinear columns have coefficients above 1, the last one drops all."""

BLOCKS = 5
"""Blocks of neighbouring rows that are left out in turn."""

INNER_COLUMNS = 3
"""Columns of an effect with a nonlinear parameter: the middles of equal parts of its prior."""

MODELS = 20
"""Bootstrapped models of an ensemble, of which the median coefficients are taken."""

Rivals = Callable[["CaseData"], Mapping[str, Any]]
"""Function from the data of a case to the answers of other methods: "stlsq" and "ensemble"."""

Regression = Callable[[Float[np.ndarray, "n_obs n_term"], Float[np.ndarray, " n_obs"], float], np.ndarray]
"""(columns, target, threshold) -> coefficients, exact zeros for terms that are dropped."""


@dataclass(frozen=True)
class Library:
    """Columns at unit RMS, and the slug of the effect of each, "" for a term of the simulation."""

    columns: Float[np.ndarray, "n_obs n_term"]
    slugs: tuple[str, ...]


def available() -> bool:
    """Return True if PySINDy is installed."""
    try:
        require()
    except InputError:
        return False
    return True


def require() -> Any:
    """Import PySINDy, on first use.

    Raises:
        InputError: It is not installed.
    """
    try:
        return importlib.import_module("pysindy")
    except ImportError as error:
        raise InputError("The comparison with PySINDy needs pysindy: pip install 'bayes-greybox[peers]'.") from error


def ask(data: CaseData) -> dict[str, Any]:
    """Return PySINDy's answers by method."""
    return {"stlsq": sindy(data), "ensemble": sindy(data, ensemble=True)}


def sindy(data: CaseData, ensemble: bool = False, seed: int = 0) -> dict[str, object]:
    """Name what is missing by sparse regression of the gap; an ensemble takes the median of bootstrapped models.

    Returns:
        "verdict" ("no gap", "recalibrate" or "named"), "names" (effects that are kept, largest first) and the chosen
        "threshold".

    Raises:
        InputError: PySINDy is not installed.
    """
    book = candidate_terms(data)
    return regressed(book.columns, book.slugs, data.residual("train"), ensemble, seed)


def regressed(
    columns: Float[np.ndarray, "n_obs n_term"], slugs: Sequence[str], gap: Float[np.ndarray, " n_obs"],
    ensemble: bool, seed: int,
) -> dict[str, object]:  # fmt: skip
    """Name what is missing by sparse regression of a gap on columns of a `Library`; see `sindy`."""
    book, gap = Library(columns, tuple(slugs)), gap / rms(gap)
    threshold = choose_threshold(_regression(), book.columns, gap)
    size = np.abs(_regression(MODELS if ensemble else 1, seed)(book.columns, gap, threshold))
    kept = [int(i) for i in np.argsort(-size) if size[i] > 0]
    names = list(dict.fromkeys(book.slugs[i] for i in kept if book.slugs[i]))
    verdict = "named" if names else "recalibrate" if kept else "no gap"
    return {"verdict": verdict, "names": names, "threshold": float(threshold)}


def candidate_terms(data: CaseData) -> Library:
    """Return the simulation's terms and the candidate effects on the training data."""
    columns, slugs = [own_terms(data)], [""] * own_terms(data).shape[1]
    # The cases of `all_cases` were settled, and run, with the terms of their time.
    for slug, effect in candidates(data, joined=not isinstance(data.case, HiddenCase)).items():
        # Every second of these nodes is the middle of an equal part.
        nodes = inner_nodes(data, effect, 1 if effect.inner is None else 2 * INNER_COLUMNS + 1)
        values = effect_values(data, effect, nodes if effect.inner is None else nodes[1::2])
        columns.append(values.T)
        slugs += [slug] * len(values)
    table = np.column_stack(columns)
    return Library(table / np.sqrt(np.mean(table**2, axis=0)), tuple(slugs))


def choose_threshold(
    fit: Regression, columns: Float[np.ndarray, "n_obs n_term"], target: Float[np.ndarray, " n_obs"]
) -> float:
    """Return the largest threshold whose error on blocks left out is within one standard error of the best."""
    rows = np.arange(len(target))
    errors = np.empty((len(THRESHOLDS), BLOCKS))
    for k, block in enumerate(np.array_split(rows, BLOCKS)):
        rest = np.setdiff1d(rows, block)
        for i, threshold in enumerate(THRESHOLDS):
            left = target[block] - columns[block] @ fit(columns[rest], target[rest], float(threshold))
            errors[i, k] = np.mean(left**2)
    mean = errors.mean(axis=1)
    best = int(np.argmin(mean))
    near = mean <= mean[best] + errors[best].std(ddof=1) / np.sqrt(BLOCKS)
    return float(THRESHOLDS[np.flatnonzero(near)[-1]])


def _regression(models: int = 1, seed: int = 0) -> Regression:
    """Return PySINDy's sequentially thresholded least squares, or an ensemble of it."""
    pysindy = require()

    def fit(columns: np.ndarray, target: np.ndarray, threshold: float) -> np.ndarray:
        optimizer = pysindy.STLSQ(threshold=threshold)
        if models > 1:
            optimizer = pysindy.EnsembleOptimizer(optimizer, bagging=True, n_models=models)
        with warnings.catch_warnings(), numpy_seed(seed):
            # It warns whenever a threshold leaves no term.
            warnings.simplefilter("ignore")
            return np.ravel(optimizer.fit(columns, target[:, None]).coef_)

    return fit


@contextmanager
def numpy_seed(seed: int) -> Iterator[None]:
    """Set NumPy's global generator, which PySINDy draws its bootstrap from, to a seed, and restore it afterwards."""
    state = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(state)  # noqa: NPY002
