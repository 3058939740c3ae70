"""The two objects that users hold: GreyBox, the model, and Fit, its posterior. Each method calls one subpackage."""

import json
import logging
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import sympy
from threadpoolctl import threadpool_limits

from bayes_greybox.criticism.checks.checks import Checks, checks
from bayes_greybox.criticism.checks.loo_pit import LooPit
from bayes_greybox.criticism.checks.whiteness import Whiteness
from bayes_greybox.criticism.convergence import LARGEST_BASIS, Verdict, boundary_needed, convergence, features_needed
from bayes_greybox.criticism.cross_validation.row_densities import log_likelihood_group
from bayes_greybox.criticism.discrepancy import DiscrepancyGrid, discrepancy_grid, discrepancy_table
from bayes_greybox.criticism.free_run import FreeRun, free_run
from bayes_greybox.criticism.inclusion import ROPE, inclusion
from bayes_greybox.criticism.kept.file import save_checked
from bayes_greybox.criticism.prediction import Prediction, completed, predict, predictive_group
from bayes_greybox.criticism.summary import summary
from bayes_greybox.criticism.trade_off import TradeOff, strongest_trade_off
from bayes_greybox.criticism.trial import try_on
from bayes_greybox.data.streams.row_stream import RowStream
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.equations.learned import LearnedSystem
from bayes_greybox.equations.of_posterior import estimated_starts, fitted_system
from bayes_greybox.equations.rates import LearnedRates, learned_rates
from bayes_greybox.inference.checkpoint import CHECKPOINT_EVERY, Checkpoint, given_checkpoint, run_facts
from bayes_greybox.inference.kept.groups import to_inferencedata
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.refinement.refine import refine
from bayes_greybox.inference.sampler.nuts import SAMPLING_LABEL
from bayes_greybox.inference.sampling import RunOptions, sample_posterior
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.model.program import Program
from bayes_greybox.model.streams.taken import taken
from bayes_greybox.report.equations.markup import equations_latex
from bayes_greybox.report.equations.record import equations_record
from bayes_greybox.report.equations.text import equations_text
from bayes_greybox.report.exports.door import export_system
from bayes_greybox.report.exports.model import Notes
from bayes_greybox.running.collecting import seldom_collected
from bayes_greybox.running.compiling import keep_programs, make_room
from bayes_greybox.running.stages import stage, stages

log = logging.getLogger(__name__)

MOST_REFITS, FEATURE_MARGIN = 2, 1.15
"""Most refits with more features; number of features given, over what the last posterior needs."""


class GreyBox(Program):
    """Simulation + sparse dictionary + orthogonal Gaussian-process discrepancy.

    See `Program` for the model and its arguments, and `OrthogonalGP` and the priors for their choices.
    """

    def fit(
        self,
        data: Trajectories | RowStream,
        *,
        draws: int = 1000,
        tune: int = 1000,
        chains: int = 4,
        seed: int = 0,
        progress: bool = True,
        target_accept: float = 0.9,
        checkpoint: str | os.PathLike[str] | Checkpoint | None = None,
        resume: bool = False,
        checkpoint_every: float = CHECKPOINT_EVERY,
    ) -> "Fit":
        """Sample the posterior with NUTS; the same seed gives the same posterior.

        If the package chooses the number of features, and the posterior needs shorter length scales than they resolve,
        it is sampled again with enough of them.

        Args:
            data: Training data, with the derivative of each learned state or samples of paths; or a `stream` of more
                rows than memory holds: all of them count, but only those of its sample are examined one by one.
            draws: Draws kept in each chain.
            tune: Warm-up iterations of each chain.
            chains: Number of chains, run in parallel threads.
            seed: Seed of everything random in the run.
            progress: If true, a progress bar is shown.
            target_accept: Target acceptance probability of NUTS.
            checkpoint: Folder that keeps the chains while they run, for `resume`; removed when the fit is complete.
            resume: If true, continue the chains in that folder; draws equal those of an uninterrupted run.
            checkpoint_every: Seconds between two checkpoints of a chain.

        Raises:
            InputError: The data or settings cannot be used, or the folder cannot be written to, is in use by another
                process, or keeps the chains of another run; the message names the remedy.
        """
        with given_checkpoint(checkpoint, resume, checkpoint_every) as opened:
            return self._fit(data, Sampling(draws, tune, chains, seed, target_accept), progress, opened)

    def _fit(
        self, source: Trajectories | RowStream, sampling: Sampling, progress: bool, checkpoint: Checkpoint | None
    ) -> "Fit":
        keep_programs()
        make_room()
        # One thread, as in `sample_posterior`, also while the fit is completed.
        with threadpool_limits(1), seldom_collected(), stages(progress):
            with stage("Reading the data"):
                model, data, rows = taken(self, source)
            whole = None if rows is None else rows.statistics(model)
            if checkpoint is not None:
                further = {} if whole is None else {"all rows": {name: each.digest for name, each in whole.items()}}
                checkpoint.require("fit", run_facts(model, data, sampling, **further))

            def sampled(model: Program, label: str = SAMPLING_LABEL) -> Posterior:
                options = RunOptions(label, None if checkpoint is None else checkpoint.next_run())
                return sample_posterior(model, data, sampling, progress=progress, whole=whole, options=options)

            posterior = sampled(model)
            for _ in range(MOST_REFITS):
                refined = _refined(posterior.model, self.discrepancy, posterior)
                if refined is None:
                    break
                log.info("sampling again, with more features: %s", refined.discrepancy)
                whole = None if rows is None else rows.statistics(refined)
                posterior = sampled(refined, "Sampling again, with finer features")
            fit = Fit(posterior.model, data, sampling, posterior.idata, posterior.made, whole)
            with stage("Predicting the measurements"):
                fit._complete()
        return fit


class Written(ABC):
    """The learned equations of a fit, or of a study's extended model, written in four ways.

    Those of a study have the coefficients of its tables, free runs and figures; for those of NUTS ask `study.fit`.
    """

    @abstractmethod
    def _system(self) -> LearnedSystem: ...

    def to_sympy(self) -> dict[str, sympy.Expr]:
        """Return the right-hand sides by state or output, over real symbols with the names of the columns.

            d(x_i)/dt = g_i(x, u) + Σ_j E[θ_ij] φ_ij(x, u) + f_i(x, u)

        Terms and coefficients are those that `print` shows, with all digits. In the equations that keep it, f is an
        undefined function `f_name(...)`; so is a simulation given as a function, `g_name(t, x, u)`.
        """
        return self._system().to_sympy()

    def to_latex(self) -> str:
        """Return all equations in LaTeX, `aligned`, with standard deviations: 1.23(4) is 1.23 ± 0.04."""
        return equations_latex(self._system())

    def to_callable(self, backend: str = "numpy", draws: int | None = None, discrepancy: bool = False) -> LearnedRates:
        """Return the right-hand side as a function `rates(t, x, u)`, which `scipy` or `diffrax` can integrate.

        x `[*n, n_state]` and u `[*n, n_input]` have the columns `rates.states` and `rates.inputs` along their last
        axis, in the units of the data; t is a number or `[*n]`. The function returns the rates of `rates.equations` in
        `rates.units`, `[*n, n_equation]`: states with an equation, then outputs.

        Args:
            backend: "numpy", or "jax" for a function that can be compiled, mapped and differentiated.
            draws: Number of draws, along a first axis, `[draws, *n, n_equation]`, each with all its terms and its own
                nonlinear parameters; `rates.draw(k)` is one. None: the equation that `print` shows, coefficients at
                their means.
            discrepancy: If true, f is added. Outside their domain features are constant, but their projection is not.

        Raises:
            InputError: An unknown backend, too many draws, or f under OrthogonalGP(path="exact").
        """
        return learned_rates(self._system(), backend, draws, discrepancy)

    def to_json(self) -> str:
        """Return the equations as JSON: terms, coefficients with 90 % intervals and inclusion, units; see the guide."""
        return json.dumps(equations_record(self._system()), indent=2, allow_nan=False, ensure_ascii=False)


class Fit(Posterior, Written):
    """The posterior of a GreyBox model: tables, predictions, free runs, and one file that holds it all."""

    @property
    def verdict(self) -> Verdict:
        """Verdict on the convergence of the chains, with reasons in words and what to try."""
        return convergence(self)

    def summary(self, level: float = 0.9) -> pd.DataFrame:
        """Return coefficients, noise and kernel of every equation with intervals, R̂ and effective sample sizes."""
        return summary(self, level)

    @property
    def noise(self) -> pd.DataFrame:
        """Estimates of `bg.Noise` for each equation; no columns if the noise is white or not estimated."""
        estimates = getattr(self.model.noise, "found", None) or {}
        equations = pd.Index(self.model.equations, name="equation")
        return pd.DataFrame([dict(estimates.get(self.model.block_of(name), {})) for name in equations], index=equations)

    def inclusion(self, level: float = 0.9, rope: float = ROPE) -> pd.DataFrame:
        """Return coefficients by (equation, term), with P(γ_j = 1) under a spike-and-slab prior."""
        return inclusion(self, level, rope)

    def discrepancy(self, level: float = 0.9) -> pd.DataFrame:
        """Return variance shares of simulation, dictionary, f and noise, and the overlap of f with the dictionary."""
        return discrepancy_table(self, level)

    def discrepancy_grid(
        self, equation: str | None = None, variables: tuple[str, ...] | None = None, size: int = 41, level: float = 0.9
    ) -> DiscrepancyGrid:
        """Return the posterior of f over one or two variables, by default for the first equation."""
        return discrepancy_grid(self, equation or next(iter(self.equations)), variables, size, level)

    def trade_off(self, equation: str | None = None) -> TradeOff:
        """Return the term whose coefficient trades off most with f, by default in the first equation."""
        return strongest_trade_off(self, equation or next(iter(self.equations)))

    def predict(self, data: Trajectories, level: float = 0.9) -> Prediction:
        """Return posterior bands of the rates at the rows of any data, with `nmse()`."""
        return predict(self, completed(self, data), level)

    def simulate(
        self, data: Trajectories, level: float = 0.9, draws: int = 50, interpolation: str | Sequence[str] | None = None
    ) -> FreeRun:
        """Integrate the whole model from the measured start of each run, with bands and `nrmse()`.

        Between samples, inputs are interpolated by lines or splines, as suits them, or by `interpolation` ("zoh":
        zero-order hold).
        """
        return free_run(self, completed(self, data), level, draws, interpolation=interpolation)

    def checks(self) -> Checks:
        """Check LOO-PIT, whiteness of the residuals and sensitivity to the prior; the table has remedies."""
        return checks(self)

    def loo_pit(self, equation: str | None = None) -> LooPit:
        """Return the quantile of each measurement in its leave-one-out prediction; by default of the first equation."""
        return checks(self).loo_pit[self.model.block_of(equation)]

    def whiteness(self, equation: str | None = None) -> Whiteness:
        """Return the autocorrelation of the whitened residuals, by default of the first equation."""
        return checks(self).whiteness[self.model.block_of(equation)]

    def sensitivity(self) -> pd.DataFrame:
        """Return the power-scaling sensitivity of θ and P(γ) to prior and likelihood, by (equation, quantity)."""
        return checks(self).sensitivity

    def refine(
        self,
        *,
        draws: int = 1000,
        tune: int = 500,
        chains: int = 4,
        seed: int = 0,
        target_accept: float = 0.8,
        starts: Mapping[str, tuple[float, float]] | None = None,
        noise: Mapping[str, tuple[float, float]] | None = None,
        progress: bool = True,
        checkpoint: str | os.PathLike[str] | Checkpoint | None = None,
        resume: bool = False,
        checkpoint_every: float = CHECKPOINT_EVERY,
    ) -> "Fit":
        """Sample the exact trajectory posterior of a fit to samples, by NUTS through the integrated paths.

            y ~ N(h(x(·; θ, f, x₀)), σ² R₀),   dx/dt = g(x, u) + e_k (Φ(x, u) θ + Ψ̃(x, u) w),   x₀ ~ N(m, s²)

        The rows of a fit are linearised around its model; here paths are integrated anew at every step. The chains
        start at draws of the fit, whose covariance is the metric. Under a spike-and-slab prior the likeliest pattern is
        fixed, and f keeps its orthogonal basis. Each path segment has its own start.

        Args:
            draws: Draws kept in each chain.
            tune: Warm-up iterations of each chain.
            chains: Number of chains, run in parallel threads.
            seed: Seed of everything random in the run.
            target_accept: Target acceptance probability of NUTS.
            starts: Prior mean and standard deviation at the start of runs, by state, in user's units; by default the
                start of the reference path, and ten times the state's size.
            noise: Prior median of each sensor's noise and standard deviation of its logarithm, by state, in user's
                units: each sensor then has its own noise. By default one noise scales all sensors, in proportion to the
                path's residuals.
            progress: If true, a progress bar is shown.
            checkpoint: Folder that keeps the chains while they run, for `resume`; removed when they are complete.
            resume: If true, continue the chains in that folder; draws equal those of an uninterrupted run.
            checkpoint_every: Seconds between two checkpoints of a chain.

        Returns:
            A fit whose posterior has `e_start` [segment, state], and `e_sensor_sigma` if each sensor has its own noise.
            Checks, leave-one-out and pages need linear rows: use the original fit.

        Raises:
            InputError: Rows of rates, whose posterior is exact already; an unknown force in the noise; priors of
                unknown states; a folder that cannot be used, or that keeps the chains of another run.
        """
        sampling = Sampling(draws, tune, chains, seed, target_accept, exact=True)
        with given_checkpoint(checkpoint, resume, checkpoint_every) as opened:
            refined = refine(self, sampling, starts, noise, progress, opened)
        return Fit(refined.model, refined.data, sampling, refined.idata)

    def to_inferencedata(self) -> Any:
        """Return the groups of `idata` in the form that the functions of the installed `arviz` take.

        With ArviZ 0.2x, the newest for Python 3.11, this is an `arviz.InferenceData`; with ArviZ 1, a `DataTree` like
        `idata`. The object is new, but its arrays are those of the fit.
        """
        return to_inferencedata(self.idata)

    def _system(self) -> LearnedSystem:
        return fitted_system(self)

    def export(self, path: str | os.PathLike[str]) -> None:
        """Write the equations as a program: .py (NumPy), .c (C99), .mo (Modelica) or .fmu, by the file extension.

        The program has the terms that `print(fit)` shows, with their mean coefficients; standard deviations, intervals
        and units are in comments. It leaves out f, as its header says. An FMU follows FMI 2.0 for Model Exchange and
        Co-Simulation; compiling it, for this system only, needs FMPy and a C compiler.

        Raises:
            InputError: Another extension; a simulation that is a function, except for .py; FMPy or the compiler is
                missing; the file cannot be written.
        """
        system = fitted_system(self)
        f = dict.fromkeys(system.with_f, "which the data tell apart from zero")
        export_system(system, path, Notes(str(self.verdict), discrepancy=f, estimated=estimated_starts(self)))

    def save(self, path: str | os.PathLike, test: Trajectories | None = None) -> None:
        """Write posterior, data, model, settings, versions and seed to one netCDF file.

        Args:
            path: Destination.
            test: Held-out data, whose error and free run go into the file, for its page.

        Raises:
            InputError: The destination cannot be written, or the held-out data lack a column.
        """
        if test is not None:
            try_on(self, test)
        save_checked(self, path)

    def to_html(self, path: str | os.PathLike, test: Trajectories | None = None) -> None:
        """Write the report as one self-contained page.

        Args:
            path: Destination.
            test: Held-out data, whose error and free run are shown; without them, the free run over the training data.

        Raises:
            InputError: The destination cannot be written, or the held-out data lack a column.
        """
        if test is not None:
            try_on(self, test)
        # Matplotlib is imported only if a page is wanted.
        from bayes_greybox.report.pages.fit_page import fit_html

        fit_html(self, path)

    def __repr__(self) -> str:
        """Show the model in one line, the verdict in words, and the learned equations."""
        s = self.sampling
        terms = ", ".join(f"{name}: {len(e.frame.dictionary)} terms" for name, e in self.equations.items())
        exact = " of exact paths" if s.exact else ""
        about = f"{self.model.prior_text} prior; {self.rows_in_words}; {s.chains} x {s.draws} draws{exact}"
        left_out = [("in the sample: " if self.whole else "") + each for each in self.model.rows.left_out(self.data)]
        equations = equations_text(fitted_system(self))
        return "\n".join([f"Fit of {terms}; {about}", *left_out, str(self.verdict), equations])

    def _complete(self) -> None:
        """Add the log-likelihood and predictive groups."""
        if (log_likelihood := log_likelihood_group(self)) is not None:
            self.add_group("log_likelihood", log_likelihood)
        for source in ("posterior", "prior"):
            if (predictive := predictive_group(self, source)) is not None:
                self.add_group(f"{source}_predictive", *predictive)


def greybox_of(program: Program) -> GreyBox:
    """Return a program as a `GreyBox`."""
    return GreyBox(**{field: getattr(program, field) for field in program.__dataclass_fields__})


def fit_of(posterior: Posterior) -> Fit:
    """Return as a `Fit` a posterior that was read from a file."""
    fit = Fit(greybox_of(posterior.model), posterior.data, posterior.sampling, posterior.idata, whole=posterior.whole)
    fit.memory.update(posterior.memory)
    return fit


def _refined(model: Program, asked: OrthogonalGP | None, posterior: Posterior) -> Program | None:
    """Return the model with the domain and features that the posterior needs, if the package is free to choose them."""
    gp = model.discrepancy
    if gp is None or asked is None or asked.features is not None:
        return None
    wider = boundary_needed(posterior)
    wanted = tuple(np.max(list(wider.values()), axis=0).tolist()) if wider else None
    # A wider domain may need too many features; then the present domain gets those that it needs.
    for boundary in dict.fromkeys((wanted, None)):
        refined = gp if boundary is None else replace(gp, boundary=boundary)
        if needed := features_needed(posterior, boundary):
            # A finer basis resolves slightly shorter length scales, hence the margin.
            per_variable = tuple(int(np.ceil(FEATURE_MARGIN * m)) for m in np.max(list(needed.values()), axis=0))
            if HilbertBasis(refined.boundary, per_variable).size > LARGEST_BASIS:
                continue
            refined = replace(refined, features=per_variable)
        return None if refined == gp else replace(model, discrepancy=refined)
    return None
