"""Exact refits without some observations, everything that the data fixed before sampling held as it was."""

from collections.abc import Sequence

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.sampling import RunOptions, sample_posterior


def refit_without(posterior: Posterior, equation: str, rows: Sequence[int], progress: bool = False) -> Posterior:
    """Run NUTS again without some observations of one equation, with the settings of the first run.

    Args:
        posterior: Fitted model.
        equation: Learned state.
        rows: Observations to leave out: rows of the data, or whitened coefficients where R is singular.
        progress: Whether to show a progress bar.

    Returns:
        A posterior with this equation only.
    """
    without = {equation: posterior.equations[equation].without(rows)}
    options = RunOptions("Fitting without what is left out", programs=posterior.programs)
    return sample_posterior(
        posterior.model, posterior.data, posterior.sampling, progress=progress, equations=without, options=options
    )
