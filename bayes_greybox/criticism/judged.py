"""Quantities that a verdict on convergence is about, and their names in plain words."""

import re
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.writing import formula
from bayes_greybox.inference.posterior import Posterior

IDENTIFIABLE_RATIO = 2.0
"""Ratio of mean to standard deviation of f, both RMS over the rows, above which f is told from zero.

If f is zero its posterior mean is less than its standard deviation, whatever its prior: with prior variance s² and
variance n² of the data's estimate of a direction, E[mean²] = s⁴n²/(s²+n²)² < s²n²/(s²+n²) = sd².
"""

JUDGED_ROWS, _NOT_JUDGED = 200, ("weight", "f", "prior_sd", "inclusion")
"""Rows, evenly spaced, at which f is judged, and quantities that are not."""

_QUANTITY_NAMES = {
    "theta": "the coefficient of {}",
    "gamma": "whether {} is in the model",
    "inclusion": "P(included) of {}",
    "sigma": "the noise's standard deviation σ",
    "noise": "the noise's standard deviation σ",
    "amplitude": "the amplitude of f",
    "length_scale": "the length scale of f along {}",
    "discrepancy": "f {}",
    "pi": "the prior share of terms in the model",
    "tau": "the prior scale of the coefficients",
    "tau_unit": "the prior scale of the coefficients",
    "slab": "the width of the prior's slab",
    "lambda": "the prior scale of the coefficient of {}",
}
"""Plain names of the sampled quantities, with a place for their term or variable."""


def judged(posterior: Posterior) -> Iterator[tuple[str, Float[np.ndarray, "n_chain n_draw"]]]:
    """Yield draws of every quantity that a verdict is about, by name: "v_theta[y**3]".

    These are coefficients, their inclusion, the noise, and the hyperparameters. If f is lost in the noise (see `lost`)
    its amplitude and length scales are left out: the data bound them from one side only, and no result depends on where
    in their prior they are. f itself is judged instead, at the row where its mean is largest and at the one where it is
    least certain.
    """
    group = posterior.drawn()
    left_out: set[str] = set()
    shape = (group.sizes["chain"], group.sizes["draw"])
    # A refit has only one of the model's equations.
    for name in posterior.equations:
        own, f = posterior.sites[name], _at_rows(posterior, name)
        # On exact paths the weights of f are sampled like everything else.
        left_out |= {own[each] for each in _NOT_JUDGED if each != "weight" or not posterior.sampling.exact}
        if f is not None and lost(f.reshape(*shape, -1), np.asarray(posterior.draws(name).hyper.sigma).reshape(shape)):
            left_out |= {own.amplitude, own.length_scale}
            mean, sd = np.abs(f.mean(axis=0)), f.std(axis=0)
            scale = posterior.equations[name].frame.target_scale
            for place, row in (("where it is largest", mean.argmax()), ("where it is least certain", sd.argmax())):
                yield f"{own['discrepancy']}[{place}]", scale * f[:, row].reshape(shape)
    for name, variable in group.data_vars.items():
        if name in left_out:
            continue
        values = variable.to_numpy().astype(float)
        labels = group[variable.dims[2]].to_numpy() if values.ndim == 3 else np.arange(values[0, 0].size)
        for label, column in zip(labels, np.moveaxis(values.reshape(*shape, -1), -1, 0), strict=True):
            yield str(name) if values.ndim == 2 else f"{name}[{label}]", column


def lost(f: Float[np.ndarray, "n_chain n_draw n_row"], sigma: Float[np.ndarray, "n_chain n_draw"]) -> bool:
    """Return True if the noise, of standard deviation sigma, hides f in every chain.

    In each chain f must not be told from zero, and be smaller than the noise in nineteen draws of twenty. So a single
    chain that has found an f is not averaged away.
    """
    size = np.sqrt(np.mean(f**2, axis=2))
    mean = np.sqrt(np.mean(f.mean(axis=1) ** 2, axis=1))
    sd = np.sqrt(np.mean(f.var(axis=1), axis=1))
    return bool(np.all(mean <= IDENTIFIABLE_RATIO * sd) and np.all(np.mean(size < sigma, axis=1) >= 0.95))


def quantity_name(quantity: str) -> str:
    """Return the plain name of a quantity in a table: "length_scale[y]" is the length scale of f along y."""
    name, _, label = quantity.removesuffix("]").partition("[")
    if name not in _QUANTITY_NAMES:
        return formula(quantity)
    return _QUANTITY_NAMES[name].format(formula(label) if name != "discrepancy" else label)


def in_words(posterior: Posterior, variable: str) -> str:
    """Return the plain name of a judged quantity, with its equation if there are several."""
    name, _, label = variable.removesuffix("]").partition("[")
    owner = posterior.sites.owner(name)
    quantity = name if owner is None else name.removeprefix(f"{owner}_")
    if quantity in _QUANTITY_NAMES:
        text = quantity_name(f"{quantity}[{label}]" if label else quantity)
    else:
        text = f"{re.sub('_+', ' ', quantity)} of the prior{f' of {formula(label)}' if label else ''}"
    if owner is None or len(posterior.equations) == 1:
        return text
    return f"{text} in {posterior.data.target_label(owner) if owner in posterior.model.equations else owner}"


def _at_rows(posterior: Posterior, name: str) -> Float[np.ndarray, "n_draw n_row"] | None:
    """Return draws of f at some rows, scaled units; None without f or if a file has no draws of it."""
    own, equation = posterior.sites[name], posterior.equations[name]
    group = posterior.drawn()
    if own.amplitude not in group or not {own["weight"], own["f"]} & set(map(str, group.data_vars)):
        return None
    n_row = equation.rows.n_row
    index = np.unique(np.linspace(0, n_row - 1, min(n_row, JUDGED_ROWS)).astype(int))
    return np.asarray(equation.discrepancy(posterior.draws(name), index))
