"""One call that fits several priors to the same data and sets their results side by side."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd
from rich.console import Console

from bayes_greybox.criticism.cross_validation.compare import compare
from bayes_greybox.criticism.cross_validation.folds import FUTURE_START, check_scheme, require_divisible
from bayes_greybox.data.trajectories import Trajectories, require_measured
from bayes_greybox.model.priors import Laplace, Normal, Prior, RegularisedHorseshoe, SpikeAndSlab
from bayes_greybox.running.errors import InputError

from .greybox import Fit, GreyBox

FOUR_PRIORS: Mapping[str, Prior] = {
    type(prior).__name__: prior for prior in (SpikeAndSlab(), RegularisedHorseshoe(), Laplace(), Normal())
}
"""Priors that `compare_priors` fits besides those of the user."""


@dataclass(frozen=True, repr=False)
class PriorComparison:
    """The same model under several priors.

    Attributes:
        fits: Fits by name of the prior.
        comparison: Table of `compare`, best first.
        inclusion: Inclusion tables side by side, indexed (equation, term), with columns (prior, quantity); only a
            spike-and-slab prior has the quantity `inclusion`, see `Fit.inclusion`.
    """

    fits: Mapping[str, Fit]
    comparison: pd.DataFrame
    inclusion: pd.DataFrame

    def __repr__(self) -> str:
        """Show the comparison with its notes, and the probability of each term under each prior."""
        with pd.option_context("display.width", 160, "display.max_columns", 40):
            parts = [
                f"Predictive accuracy, leaving out {self.comparison.attrs['folds']} (elpd in nats, best first)",
                self.comparison.round(2).to_string(),
                *(f"- {note}" for note in self.comparison.attrs["notes"]),
                "",
                "Probability of each term: P(included) under spike-and-slab priors, P(|θ| > ROPE) under the others",
                self.probability.round(3).to_string(),
            ]
        return "\n".join(parts)

    @property
    def probability(self) -> pd.DataFrame:
        """`inclusion` if a prior has it, else `outside_rope`, by (equation, term), one column for each prior."""
        tables = {name: self.inclusion[name] for name in self.fits}
        return pd.DataFrame(
            {name: table["inclusion" if "inclusion" in table else "outside_rope"] for name, table in tables.items()}
        )

    def to_html(self, path: str | os.PathLike) -> None:
        """Write the report as one self-contained page."""
        # Matplotlib is imported only if a page is wanted.
        from bayes_greybox.report.pages.comparison_page import comparison_html

        comparison_html(self.fits, self.comparison, path)


def compare_priors(
    model: GreyBox,
    data: Trajectories,
    priors: Mapping[str, Any] | None = None,
    *,
    scheme: str = "loo",
    block: int | None = None,
    start: float = FUTURE_START,
    max_refits: int = 10,
    draws: int = 1000,
    tune: int = 1000,
    chains: int = 4,
    seed: int = 0,
    target_accept: float = 0.9,
    progress: bool = True,
) -> PriorComparison:
    """Fit a model under the four priors and any others, and compare them by cross-validation.

    Args:
        model: The model; its own prior is replaced.
        data: Training data, the same for all.
        priors: Further priors by name. One named like one of the four ("SpikeAndSlab", "RegularisedHorseshoe",
            "Laplace", "Normal") replaces it, and None leaves it out.
        scheme: As for `compare`.
        block: As for `compare`.
        start: As for `compare`.
        max_refits: As for `compare`.
        draws: As for `GreyBox.fit`, as are the settings that follow.
        tune: Warm-up iterations of each chain.
        chains: Number of chains.
        seed: Seed of each run.
        target_accept: Target acceptance probability of NUTS.
        progress: If true, each prior is named as its fit begins, and progress bars are shown.

    Raises:
        InputError: Something that is not a prior, fewer than two priors, or anything that `fit` or `compare` refuses.
    """
    check_scheme(scheme, block, start)
    require_measured(data)
    require_divisible(data, model.equations, scheme)
    chosen = {name: prior for name, prior in {**FOUR_PRIORS, **(priors or {})}.items() if prior is not None}
    for name, prior in chosen.items():
        if not isinstance(prior, Prior):
            raise InputError(f"priors[{name!r}] = {prior!r} is not a prior: give one such as bg.Laplace(scale=0.5).")
    if len(chosen) < 2:
        raise InputError(f"compare_priors needs at least two priors, not {len(chosen)}: leave fewer of them out.")
    models: dict[str, Any] = {name: replace(model, prior=prior) for name, prior in chosen.items()}
    console = Console(quiet=not progress, highlight=False)
    fits = {}
    for i, (name, variant) in enumerate(models.items(), start=1):
        console.print(f"Prior {name} ({i} of {len(models)})")
        fits[name] = variant.fit(
            data, draws=draws, tune=tune, chains=chains, seed=seed, target_accept=target_accept, progress=progress
        )
    table = compare(fits, scheme, block=block, start=start, max_refits=max_refits, progress=progress)
    inclusion = pd.concat({name: fit.inclusion() for name, fit in fits.items()}, axis=1, names=["prior", "quantity"])
    return PriorComparison(fits, table, inclusion)
