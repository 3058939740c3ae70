"""Rows that the noise weights by their own residuals, so that a row influences its own prediction."""

from collections.abc import Mapping

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.running.errors import InputError

WEIGHTED_NOTE = (
    "Noise(tails=...) gave each row its weight by its own residual, which a prediction cannot know: elpd is too high, "
    "and compares with that of fits with the same tails alone."
)
"""Warning about the densities of such rows."""


def weighted(posterior: Posterior) -> bool:
    """Return True if the noise weights rows by their residuals."""
    noise = posterior.model.noise
    asked, found = getattr(noise, "tails", None), getattr(noise, "found", None)
    return asked is not None and (found is None or any("degrees" in each for each in found.values()))


def require_weighted_alike(fits: Mapping[str, Posterior]) -> None:
    """Require that all fits weight rows by their residuals, or none of them, or raise InputError."""
    kinds = {name: weighted(fit) for name, fit in fits.items()}
    if any(kinds.values()) and not all(kinds.values()):
        (heavy, *_), (plain, *_) = ([n for n, w in kinds.items() if w is which] for which in (True, False))
        raise InputError(
            f"compare: {heavy!r} has Noise(tails=...), which weighs each row by its own residual and so predicts what "
            f"it has seen, and {plain!r} has not: fit all with the same Noise(tails=4.0), say, or all without, and ask "
            "fit.checks() which noise the data want."
        )
