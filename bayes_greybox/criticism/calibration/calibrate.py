"""Simulation-based calibration of the posterior of data drawn from the model.

If the truth is drawn from the prior and data from the truth, then the truth is one more posterior draw, and its rank
among the others is uniform for every quantity (Talts et al. 2018; Modrák et al. 2023). An error in the density, the
sampler or the conditional draws shows in some rank.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass

import jax
import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from bayes_greybox.criticism.convergence import Verdict
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.sampler.prior_data import draw_truths, open_equation
from bayes_greybox.inference.sampler.replicates import sample_replicates
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.model.program import Program
from bayes_greybox.model.sites import Sites
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.stages import stage, stages

from .coverage import coverage_table, places
from .quantities import quantities
from .ranks import Ranks, rank_truths
from .reliability import Reliability, reliability
from .uniformity import Band, ecdf_difference, simultaneous_band, uniformity_p

FEWEST_REPLICATES = 20
"""Fewest replicates whose ranks are worth a test."""


class CalibrationVerdict(Verdict):
    """A verdict on the tests of a calibration."""

    def __str__(self) -> str:
        return "Calibrated: no test failed." if self.ok else "\n- ".join(["Not calibrated:", *self.reasons])


@dataclass(frozen=True, repr=False)
class Calibration:
    """Result of the simulation-based calibration of a model.

    Attributes:
        level: Probability that a calibrated model fails any of the tests.
        tests: One row a test: kind ("rank": ranks are uniform; "inclusion": the frequency of a term agrees with its
            probabilities; "reliability": the expected calibration error is small), p (exact, each by itself), adjusted
            (Holm, over all rows) and passed (adjusted > level).
        ranks: One row a replicate, one column a quantity: rank of the truth among the thinned draws.
        kept: Number of the thinned draws.
        pit: The ranks on (0, 1), ties broken at random: uniform if the model is calibrated.
        ess: Median effective sample size of each quantity.
        inclusion: Reliability of P(γ) by equation; empty without a spike-and-slab prior.
        coverage: Share of true f inside the posterior band, by (equation, region, level), with its standard error;
            regions are "data" (at the rows), "box" (in their box, away from them) and "beyond" (outside, up to 1.3
            half-widths from its centre). It is not tested.
        divergences: Divergences of each replicate.
        seconds: Wall time of drawing, compiling and sampling.
    """

    level: float
    tests: pd.DataFrame
    ranks: pd.DataFrame
    kept: pd.DataFrame
    pit: pd.DataFrame
    ess: pd.Series
    inclusion: Mapping[str, Reliability]
    coverage: pd.DataFrame
    divergences: np.ndarray
    seconds: float

    @property
    def replicates(self) -> int:
        """Number of replicates."""
        return len(self.pit)

    @property
    def band(self) -> Band:
        """Band that the ECDF differences of any quantity leave with probability `level` at most."""
        return simultaneous_band(self.replicates, self.level / len(self.tests))

    @property
    def ecdf_differences(self) -> pd.DataFrame:
        """F̂(z) − z of the ranks of each quantity, one row for each z."""
        return pd.DataFrame(
            {name: ecdf_difference(self.pit[name].to_numpy()) for name in self.pit},
            index=pd.Index(self.band.at, name="z"),
        )

    @property
    def verdict(self) -> CalibrationVerdict:
        """Verdict at the stated level, with the failed tests."""
        words = {
            "rank": "the ranks of {} are not uniform",
            "inclusion": "{} is included more or less often than its probabilities say",
            "reliability": "inclusion probabilities of {} are off by more than chance",
        }
        failed = self.tests.loc[~self.tests["passed"].to_numpy(bool)].sort_values("adjusted")
        reasons = tuple(
            f"{words[row.kind].format(row.Index)} (adjusted p = {row.adjusted:.2g})." for row in failed.itertuples()
        )
        return CalibrationVerdict(failed.empty, reasons)

    def __repr__(self) -> str:
        """Show replicates, verdict and the smallest p-values."""
        least = self.tests.sort_values("adjusted").head(5)
        lines = [
            f"Calibration over {self.replicates} replicates; {len(self.tests)} tests, level {self.level:g} in all",
            str(self.verdict),
            least.to_string(float_format=lambda value: f"{value:.3g}"),
        ]
        lines += [
            f"Expected calibration error of P(included), {name}: {each.ece:.3f} ({each.expected_ece:.3f} if calibrated)"
            for name, each in self.inclusion.items()
        ]
        if diverged := int(np.sum(self.divergences > 0)):
            lines.append(f"{diverged} replicates had divergences.")
        return "\n".join(lines)


def calibrate(
    model: Program, data: Trajectories, *, replicates: int = 500, draws: int = 300, tune: int = 300, seed: int = 0,
    target_accept: float = 0.9, level: float = 0.01, progress: bool = True,
) -> Calibration:  # fmt: skip
    """Calibrate a model by simulation at the rows of some data, whose measured rates are not used.

    For each replicate η and the prior scales are drawn from the prior, then γ, θ, f and y = Φθ + f + σε on the rows
    as they were measured. The posterior is that of a fit: its density, its NUTS kernel and its conditional draws, one
    chain a replicate, compiled once. Ranked are θ, σ, amplitude, length scales and the prior's scalar scales, the
    number of included terms, f at a place of each region and its RMS over the rows, and the log likelihood, which is
    sensitive to errors that marginal ranks miss (Modrák et al. 2023, Sec. 4). Terms and target are scaled as the data.

    Args:
        model: Model to test; its prior must be proper.
        data: Rows: states, inputs and noise covariance. Few rows and terms keep it fast.
        replicates: Number of replicates.
        draws: Draws of each replicate.
        tune: Warm-up iterations of each.
        seed: Seed of everything random.
        target_accept: Target acceptance probability of NUTS.
        level: Probability that a calibrated model fails: tests are adjusted for their number.
        progress: If true, a progress bar is shown.

    Raises:
        InputError: Too few replicates, a level outside (0, 1), or data that `GreyBox.fit` refuses.
    """
    if replicates < FEWEST_REPLICATES:
        raise InputError(f"calibrate(replicates={replicates}) says nothing: give {FEWEST_REPLICATES} at least.")
    if not 0 < level < 1:
        raise InputError(f"calibrate(level={level:g}) must lie between 0 and 1.")
    sampling = Sampling(draws, tune, 1, seed, target_accept)
    start = time.perf_counter()
    opened = {name: open_equation(equation) for name, equation in model.assemble(data).items()}
    prior_key, chain_key = jax.random.split(jax.random.PRNGKey(seed))
    generator = np.random.default_rng(seed)
    truths, targets = draw_truths(model, opened, replicates, prior_key, generator)
    designs = {name: part.equation.design for name, part in opened.items()}
    keys = jax.random.split(chain_key, replicates)
    # Threads inside BLAS fight those of the chains over the cores, for matrices too small to share.
    with threadpool_limits(1), stages(progress), stage("Calibrating", replicates) as line:
        samples, divergences = sample_replicates(model, designs, targets, keys, sampling, line.advance)
    seconds = time.perf_counter() - start

    where = {name: places(part.equation.frame, data) for name, part in opened.items()}
    ranks = {
        name: rank_truths(truth, drawn, generator)
        for name, truth, drawn in quantities(opened, targets, truths, samples, where)
    }
    inclusion = {}
    for name, part in opened.items():
        own = model.sites[name]
        if own.inclusion in samples:
            gamma, drawn = (values[own.gamma].astype(float) for values in (truths, samples))
            terms, probability = part.equation.frame.dictionary.names, samples[own.inclusion].mean(axis=1)
            inclusion[name] = reliability(gamma, probability, drawn, terms, generator)
    rank, kept, pit, ess = (
        pd.DataFrame({name: getattr(each, field) for name, each in ranks.items()}) for field in Ranks._fields
    )
    coverage = coverage_table(opened, where, truths, samples, generator)
    tests = _tests(pit, inclusion, level)
    return Calibration(level, tests, rank, kept, pit, ess.median(), inclusion, coverage, divergences, seconds)


def _tests(pit: pd.DataFrame, inclusion: Mapping[str, Reliability], level: float) -> pd.DataFrame:
    """Return the table of tests, with Holm's adjustment."""
    tests = [("rank", str(name), uniformity_p(pit[name].to_numpy())) for name in pit]
    for name, part in inclusion.items():
        gamma = Sites([name])[name].gamma
        tests += [("inclusion", f"{gamma}[{term}]", p) for term, p in part.terms["p"].to_dict().items()]
        tests += [("reliability", gamma, part.p)]
    table = pd.DataFrame(tests, columns=["kind", "quantity", "p"])
    order = np.argsort(table["p"].to_numpy(), kind="stable")
    adjusted = np.empty(len(table))
    # Holm 1979: the i-th smallest of m is multiplied by m − i, and none is below its predecessor.
    adjusted[order] = np.maximum.accumulate(table["p"].to_numpy()[order] * np.arange(len(table), 0, -1))
    table["adjusted"] = np.minimum(adjusted, 1.0)
    table["passed"] = table["adjusted"] > level
    return table.set_index("quantity")
