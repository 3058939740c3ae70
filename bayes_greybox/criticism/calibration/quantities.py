"""Quantities that simulation-based calibration ranks: parameters, and functions of parameters and data."""

from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Float

from bayes_greybox.inference.sampler.prior_data import OpenEquation
from bayes_greybox.model.sites import EquationSites, Sites

from .coverage import REGIONS, Places, f_at


def quantities(
    equations: Mapping[str, OpenEquation], targets: Mapping[str, np.ndarray], truths: Mapping[str, np.ndarray],
    samples: Mapping[str, np.ndarray], where: Mapping[str, Places],
) -> Iterator[tuple[str, Float[np.ndarray, " n_replicate"], Float[np.ndarray, "n_replicate n_draw"]]]:  # fmt: skip
    """Yield name, true value and draws of every ranked quantity, f at some places among them.

    `targets` are the compressed ones; `truths` have the names of posterior draws.
    """
    sites = Sites(equations)
    for name, part in equations.items():
        frame, own = part.equation.frame, sites[name]
        for j, term in enumerate(frame.dictionary.names):
            yield f"{own.theta}[{term}]", truths[own.theta][:, j], samples[own.theta][..., j]
        key = own.length_scale
        for j, variable in enumerate(frame.variables):
            yield f"{key}[{variable}]", truths[key][:, j], samples[key][..., j]
        for key in sites.owned(name, truths).values():
            if truths[key].ndim == 1 and key not in own.raw:
                yield key, truths[key], samples[key]
        if own.gamma in truths:
            yield own["terms_in"], *(values[own.gamma].astype(float).sum(axis=-1) for values in (truths, samples))
        truth, drawn = (
            _log_likelihood(part, y, values, own)
            for values, y in ((truths, targets[name]), (samples, targets[name][:, None]))
        )
        yield own["log_likelihood"], truth, drawn
        if frame.variables:
            for region, index in zip(*np.unique(where[name].region, return_index=True), strict=True):
                truth, drawn = (f_at(where[name], values, own, index) for values in (truths, samples))
                yield f"{own.f}[{REGIONS[region]}]", truth, drawn
            truth, drawn = (np.sqrt(np.mean(_f(part, values, own) ** 2, axis=-1)) for values in (truths, samples))
            yield own["f_rms"], truth, drawn


def _f(part: OpenEquation, values: Mapping[str, np.ndarray], own: EquationSites) -> np.ndarray:
    """Return f at the compressed rows, which have the same sum of squares; zero without a discrepancy."""
    absent = np.zeros((*values[own.theta].shape[:-1], 0))
    return part.equation.design.on_rows(values.get(own.weight, absent), values.get(own.f, absent))


def _log_likelihood(
    part: OpenEquation, y: np.ndarray, values: Mapping[str, np.ndarray], own: EquationSites
) -> np.ndarray:
    """Return −n log σ − ‖y − Φθ − f‖²/(2σ²)."""
    design = part.equation.design
    residual = y - values[own.theta] @ np.asarray(design.Phi).T - _f(part, values, own)
    sigma = values[own.sigma]
    return -float(design.n_obs) * np.log(sigma) - np.sum(residual**2, axis=-1) / (2 * sigma**2)
