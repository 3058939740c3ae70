"""Which quantities a verdict on convergence is about, and what they are called."""

import re
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.writing import formula
from bayes_greybox.inference.posterior import Posterior

TOLD = 2.0
"""f is told from zero where its mean is so many of its standard deviations, as RMS over the rows.

Where f is zero its posterior mean is less than its standard deviation, whatever its prior: with prior variance s² and
variance n² of what the data say of a direction, E[mean²] = s⁴n²/(s²+n²)² < s²n²/(s²+n²) = sd².
"""

ROWS = 200
"""Rows, evenly spaced, at which f is looked at."""

_NOT_JUDGED = ("weight", "f", "prior_sd", "inclusion")

_QUANTITIES = {
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
"""Plain names of the sampled quantities, with a place for the term or the variable that one belongs to."""


def judged(posterior: Posterior) -> Iterator[tuple[str, Float[np.ndarray, "n_chain n_draw"]]]:
    """Draws of every quantity that a verdict rests on, by name: "v_theta[y**3]".

    Those are coefficients and which of them are in the model, the noise, and the hyperparameters. Where f is lost in
    the noise (see `lost`) its amplitude and length scales are not among them: the data bound them from one side only,
    they wander over their prior, and nothing that is said rests on where. f itself is judged in their place, at the
    row where its mean is largest and at the one where it is least certain.

    Args:
        posterior: Fitted model.
    """
    group = posterior.drawn()
    # On exact paths the weights of f are sampled as everything else.
    drawn = _NOT_JUDGED[1:] if posterior.sampling.exact else _NOT_JUDGED
    # A refit holds one equation of the model's.
    held = {name: posterior.sites[name] for name in posterior.equations}
    left_out = {own[name] for own in held.values() for name in drawn}
    shape = (group.sizes["chain"], group.sizes["draw"])
    for name, own in held.items():
        f = _at_rows(posterior, name)
        if f is not None and lost(f.reshape(*shape, -1), np.asarray(posterior.draws(name).hyper.sigma).reshape(shape)):
            left_out |= {own.amplitude, own.length_scale}
            mean, sd = np.abs(f.mean(axis=0)), f.std(axis=0)
            scale = posterior.equations[name].frame.target_scale
            for what, row in (("where it is largest", mean.argmax()), ("where it is least certain", sd.argmax())):
                yield f"{own['discrepancy']}[{what}]", scale * f[:, row].reshape(shape)
    for name, variable in group.data_vars.items():
        if name in left_out:
            continue
        values = variable.to_numpy().astype(float)
        if values.ndim == 2:
            yield str(name), values
            continue
        labels = group[variable.dims[2]].to_numpy() if values.ndim == 3 else np.arange(values[0, 0].size)
        for label, column in zip(labels, np.moveaxis(values.reshape(*values.shape[:2], -1), -1, 0), strict=True):
            yield f"{name}[{label}]", column


def lost(f: Float[np.ndarray, "n_chain n_draw n_row"], sigma: Float[np.ndarray, "n_chain n_draw"]) -> bool:
    """Whether the noise hides f in every chain: not told from zero, and in nineteen draws of twenty smaller than it.

    Each chain is asked by itself: one that has found an f where the others have none is not averaged away, and then
    its amplitude and length scales are judged as everything else.

    Args:
        f: Draws of f at some rows.
        sigma: Draws of the noise's standard deviation, in the same unit.
    """
    size = np.sqrt(np.mean(f**2, axis=2))
    mean = np.sqrt(np.mean(f.mean(axis=1) ** 2, axis=1))
    sd = np.sqrt(np.mean(f.var(axis=1), axis=1))
    return bool(np.all(mean <= TOLD * sd) and np.all(np.mean(size < sigma, axis=1) >= 0.95))


def quantity_name(quantity: str) -> str:
    """Plain name of a quantity of one equation: "length_scale[y]" is the length scale of f along y.

    Args:
        quantity: As tables have it, a term or a name of the package's.
    """
    name, _, label = quantity.removesuffix("]").partition("[")
    if name not in _QUANTITIES:
        return formula(quantity)
    return _QUANTITIES[name].format(formula(label) if name != "discrepancy" else label)


def in_words(posterior: Posterior, variable: str) -> str:
    """Plain name of a judged quantity, with its equation where there are several.

    Args:
        posterior: Fitted model.
        variable: As `judged` names it.
    """
    name, _, label = variable.removesuffix("]").partition("[")
    owner = posterior.sites.owner(name)
    own = name if owner is None else name.removeprefix(f"{owner}_")
    if own in _QUANTITIES:
        said = quantity_name(f"{own}[{label}]" if label else own)
    else:
        said = f"{re.sub('_+', ' ', own)} of the prior{f' of {formula(label)}' if label else ''}"
    if owner is None or len(posterior.equations) == 1:
        return said
    return f"{said} in {posterior.data.target_label(owner) if owner in posterior.model.equations else owner}"


def _at_rows(posterior: Posterior, name: str) -> Float[np.ndarray, "n_draw n_row"] | None:
    """Draws of f at some rows, scaled units; None without f or where a file holds no draws of it."""
    own, equation = posterior.sites[name], posterior.equations[name]
    group = posterior.drawn()
    if own.amplitude not in group or not {own["weight"], own["f"]} & set(map(str, group.data_vars)):
        return None
    n_row = equation.rows.n_row
    index = np.unique(np.linspace(0, n_row - 1, min(n_row, ROWS)).astype(int))
    return np.asarray(equation.discrepancy(posterior.draws(name), index))
