"""What simulation-based calibration ranks: parameters, and functions of parameters and data that see more than them."""

from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Float

from bayes_greybox.inference.truths import Rows
from bayes_greybox.model.likelihood import FeatureDesign

from .coverage import Places, f_at

_RAW = ("noise", "tau_unit")
"""Coordinates of the sampler that another quantity tells."""


def ranked_quantities(
    rows: Mapping[str, Rows],
    targets: Mapping[str, np.ndarray],
    truths: Mapping[str, np.ndarray],
    samples: Mapping[str, np.ndarray],
    where: Mapping[str, Places],
) -> Iterator[tuple[str, Float[np.ndarray, " n_replicate"], Float[np.ndarray, "n_replicate n_draw"]]]:
    """Name, true value and draws of everything that is ranked.

    Args:
        rows: Equations.
        targets: Compressed targets.
        truths: True values under the names of posterior draws.
        samples: Posterior draws.
        where: Places where f is ranked.
    """
    for name, part in rows.items():
        frame, prefix = part.equation.frame, f"{name}_"
        for j, term in enumerate(frame.dictionary.names):
            yield f"{prefix}theta[{term}]", truths[f"{prefix}theta"][:, j], samples[f"{prefix}theta"][..., j]
        for j, variable in enumerate(frame.variables):
            key = f"{prefix}length_scale"
            yield f"{key}[{variable}]", truths[key][:, j], samples[key][..., j]
        for key, truth in truths.items():
            if key.startswith(prefix) and truth.ndim == 1 and key.removeprefix(prefix) not in _RAW:
                yield key, truth, samples[key]
        if f"{prefix}gamma" in truths:
            number = truths[f"{prefix}gamma"].sum(axis=1), pattern_draws(samples, name).sum(axis=2)
            yield f"{prefix}terms_in", number[0].astype(float), number[1]
        truth, drawn = _log_likelihood(part, targets[name], name, truths, samples)
        yield f"{prefix}log_likelihood", truth, drawn
        if frame.variables:
            for region, index in where[name].first():
                truth, drawn = (f_at(where[name], values, name, index) for values in (truths, samples))
                yield f"{prefix}f[{region}]", truth, drawn
            truth, drawn = (np.sqrt(np.mean(_f(part, values, name) ** 2, axis=-1)) for values in (truths, samples))
            yield f"{prefix}f_rms", truth, drawn


def pattern_draws(samples: Mapping[str, np.ndarray], name: str) -> Float[np.ndarray, "n_replicate n_draw n_term"]:
    """Draws of γ as numbers, whether they were drawn afterwards or are a site."""
    return samples[f"{name}_gamma"].astype(float)


def _f(part: Rows, values: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    """F at the compressed rows, which keep its sum of squares."""
    design = part.equation.design
    if isinstance(design, FeatureDesign):
        return values[f"{name}_weight"] @ np.asarray(design.Psi).T
    f = values[f"{name}_f"]
    return f if design.whitening is None else f @ np.asarray(design.whitening).T


def _log_likelihood(
    part: Rows,
    target: np.ndarray,
    name: str,
    truths: Mapping[str, np.ndarray],
    samples: Mapping[str, np.ndarray],
) -> Iterator[np.ndarray]:
    """−n log σ − ‖y − Φθ − f‖²/(2σ²) of the truth and of every draw."""
    design = part.equation.design
    for values, y in ((truths, target), (samples, target[:, None])):
        residual = y - values[f"{name}_theta"] @ np.asarray(design.Phi).T - _f(part, values, name)
        sigma = values[f"{name}_sigma"]
        yield -float(design.n_obs) * np.log(sigma) - np.sum(residual**2, axis=-1) / (2 * sigma**2)
