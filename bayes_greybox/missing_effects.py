"""The missing effects of a simulation, for users: `find_missing_effects`, and its result, `Study`."""

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from bayes_greybox.criticism.kept.file import checked_of
from bayes_greybox.data.trajectories import Trajectories, with_filter_of
from bayes_greybox.discovery.answer.free_runs import FreePath, FreeRuns
from bayes_greybox.discovery.decision.criteria import Criteria
from bayes_greybox.discovery.extended import hidden_used
from bayes_greybox.discovery.learned import studied_system
from bayes_greybox.discovery.next_experiment.ranked import WORTH_DOING, NextExperiment, rank
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.discovery.study import StudyResult, StudySettings, investigate
from bayes_greybox.discovery.study_file import holds_study, save_study, study_of
from bayes_greybox.equations.learned import LearnedSystem
from bayes_greybox.equations.of_posterior import estimated_starts
from bayes_greybox.inference.checkpoint import CHECKPOINT_EVERY, Checkpoint, data_facts, given_checkpoint, run_facts
from bayes_greybox.inference.kept import netcdf
from bayes_greybox.inference.kept.damage import made_of
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.physics.catalogue.loading import CatalogueSpec
from bayes_greybox.physics.experiments.candidate import Candidate
from bayes_greybox.physics.simulation.fmu.given import FMU
from bayes_greybox.physics.simulation.protocol import RightHandSide
from bayes_greybox.report.equations.text import equations_text
from bayes_greybox.report.exports.door import export_system
from bayes_greybox.report.exports.model import Notes
from bayes_greybox.report.words.asked import asked
from bayes_greybox.report.words.sentence import measurement_in_words, sentence
from bayes_greybox.running.compiling import keep_programs, make_room
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.stages import announce, stages

from .greybox import Fit, GreyBox, Written, fit_of, greybox_of


@dataclass(frozen=True, repr=False)
class Study(StudyResult, Written):
    """The effects that a simulation lacks, with the evidence; see `StudyResult` for its tables.

    `fit` is None if nothing was sampled, as under settle=False. Tables come from the noise grid either way;
    `study.model.fit(study.train)` samples the extended model.
    """

    base: GreyBox
    model: GreyBox
    fit: Fit | None

    @property
    def sentence(self) -> str:
        """The verdict in one sentence."""
        return sentence(self)

    def record(self) -> dict[str, Any]:
        """Return verdict, sentence, what it asks of you, tables and settings as plain values, ready for JSON."""
        to_do = [asdict(each) for each in asked(self)]
        return {"verdict": self.verdict, "sentence": self.sentence, "asked": to_do, **super().record()}

    def free_run(self, data: Trajectories, interpolation: str | Sequence[str] | None = None) -> dict[str, FreePath]:
        """Return free runs, before and after, over other data, by state.

        Args:
            data: Times, starts and inputs to follow; samples without every state start on the path through them.
            interpolation: Interpolation of the inputs between samples, as in `find_missing_effects`.

        Raises:
            InputError: A state has no equation to integrate; only outputs were studied.
        """
        moving = {name: each for name, each in self.amendments.items() if not self.train.is_output(name)}
        if not moving:
            studied = ", ".join(self.amendments)
            raise InputError(
                f"There is nothing to integrate: what was studied, {studied}, has no derivative in its equation."
            )
        simulation = self.model.simulator(data, lacking=True)
        if not set(simulation.states) <= set(data.state_names):
            data = self.model.rows.complete_all(data, tuple(self.amendments), simulation)
        paths = FreeRuns(self.base.centred(), moving, interpolation)(data, "")[0]
        if not paths:
            raise InputError("A state of the data has no equation to integrate: add it to the simulation.")
        return paths

    def _system(self) -> LearnedSystem:
        return studied_system(self)

    def export(self, path: str | os.PathLike[str]) -> None:
        """Write the extended model as a program; see `Fit.export`.

        Hidden states of effects with memory are states of the program. Sensor errors are listed in its header, not put
        into the equations.

        Raises:
            InputError: See `Fit.export`.
        """
        system = studied_system(self)
        remarks = tuple(f"About the sensors, not the machine: {text}." for text in measurement_in_words(self))
        left = dict.fromkeys(system.with_f, "the unnamed discrepancy")
        states = self.model.states(self.train)
        starts = {} if self.fit is None else estimated_starts(self.fit)
        export_system(system, path, Notes(self.sentence, remarks, left, self.model.rows.starts, states, starts))

    def next_experiment(
        self,
        candidates: Sequence[Candidate] | None = None,
        *,
        sensors: Mapping[str, float] | None = None,
        batch: int = 1,
        threshold: float = WORTH_DOING,
        outcomes: int = 64,
        seed: int = 0,
        **usual: Any,
    ) -> NextExperiment:
        """Return the next experiment to do, by its expected information about which explanation holds.

        Args:
            candidates: Experiments to choose from; by default `usual_candidates` of the training data.
            sensors: Noise by channel, for the default candidates; by default as in the data.
            batch: Experiments to do together, chosen one after another.
            threshold: Bits below which no experiment is worth doing.
            outcomes: Runs simulated for each explanation, for bands and failures; the information has a closed form.
            seed: Seed of these runs.
            **usual: Signals, amplitudes, starts, duration and rows of `usual_candidates`.

        Raises:
            InputError: See `ranked.rank` and `usual_candidates`.
        """
        return rank(
            self, candidates, sensors=sensors, batch=batch, threshold=threshold, outcomes=outcomes, seed=seed, **usual
        )

    def save(self, path: str | os.PathLike) -> None:
        """Write the study to one netCDF file: tables, data, models, equations and free runs, and the posterior.

        `bg.load` reads it, `bayes-greybox report` writes its page, and ArviZ reads the posterior of the extended model,
        which is missing where nothing was sampled (settle=False).

        Raises:
            InputError: The destination cannot be written.
        """
        save_study(self, path, self.record())

    def to_html(self, path: str | os.PathLike) -> None:
        """Write the report as one self-contained page."""
        # Matplotlib is imported only where a page is wanted.
        from bayes_greybox.report.pages.study_page import study_html

        study_html(self, path)

    def __repr__(self) -> str:
        """Return the verdict in words, and the equations of the extended model."""
        return f"Study: {self.verdict}\n{self.sentence}\n{equations_text(studied_system(self))}"


def load(path: str | os.PathLike, simulation: RightHandSide | FMU | None = None) -> Any:
    """Read a file from `Fit.save` or `Study.save`.

    Args:
        path: The netCDF file.
        simulation: The simulation's function, if the model had one; a file cannot hold code.

    Returns:
        A `Fit`, or a `Study` with its tables and its fit.

    Raises:
        InputError: The file is missing or not of this package, holds a study in an earlier layout, or needs a function.
    """
    tree = netcdf.read(path)
    with made_of(path):
        if not holds_study(tree):
            return fit_of(checked_of(tree, simulation))
        found = study_of(tree, simulation)
    fit = None if found.fit is None else fit_of(found.fit)
    return _study(found, base=greybox_of(found.base), model=greybox_of(found.model), fit=fit)


def _study(found: StudyResult, **changed: Any) -> Study:
    return Study(**{field.name: getattr(found, field.name) for field in fields(found)} | changed)


def find_missing_effects(
    model: GreyBox,
    train: Trajectories,
    test: Trajectories | None = None,
    *,
    catalogue: CatalogueSpec = "mechanical",
    roles: Mapping[str, str | Sequence[str]] | None = None,
    seed: int = 0,
    effects_at_most: int = 3,
    negligible: float = Criteria.negligible,
    odds: Odds | None = None,
    settle: bool = True,
    free_runs: bool = True,
    interpolation: str | Sequence[str] | None = None,
    draws: int = 1000,
    tune: int = 1000,
    chains: int = 4,
    progress: bool = True,
    checkpoint: str | os.PathLike[str] | Checkpoint | None = None,
    resume: bool = False,
    checkpoint_every: float = CHECKPOINT_EVERY,
) -> Study:
    """Find the effects that a simulation lacks: where it disagrees with the data, why, and the gap that remains.

    The simulation is trusted: the coefficients of its additive terms change only if the data say so. Terms of the
    model's dictionary are free: their coefficients are learned in every hypothesis. Hypotheses are weighed by their
    evidence (see `discovery.grid`), each summed over discrepancies, such as a latent force in time.

    Args:
        model: Simulation, and the terms whose coefficients are to be learned anyway. `model.discrepancy` sets the
            variables of f.
        train: Measurements with the rates of the equations in question, or with the outputs.
        test: Held-out measurements, on which no hypothesis is weighed: they show the remaining gap, and can only
            contradict the answer. If only the training data were differentiated, the same filter is applied to these.
        catalogue: "mechanical", "fluid", "population", "electrical", "thermal", "battery", "compartment", "vehicle",
            "all" but that of vehicles, a TOML file of your own, or a list of these; [] weighs no effects, only sensor
            errors, corrections and an unnamed discrepancy.
        roles: Columns by role where the package should not guess.
        seed: Seed of everything random.
        effects_at_most: Largest number of effects added to one equation.
        negligible: RMS of an unnamed discrepancy, over that of the modelled rate, below which simulation and
            measurement agree in practice.
        odds: Prior probabilities of the hypotheses.
        settle: If true, sample the extended model by NUTS. If false, `study.fit` is None; tables, figures and page need
            no sampling.
        free_runs: If true, integrate simulation and extended model over the data.
        interpolation: Interpolation of the inputs between samples in free runs: "linear", "cubic" or "zoh" (held), one
            for all or for each. By default linear or cubic, whichever predicts the samples of that input better.
        draws: Draws in each chain of the extended model.
        tune: Warm-up iterations of each chain.
        chains: Chains.
        progress: If true, show progress.
        checkpoint: Folder that keeps the chains of the extended model while they run; removed when the study is
            complete.
        resume: If true, continue the chains in that folder; hypotheses are weighed again, with the same outcome.
        checkpoint_every: Seconds between two checkpoints of a chain.

    Raises:
        InputError: Data, model or catalogue that cannot be used; the message names the remedy.
    """
    keep_programs()
    make_room()
    settings = StudySettings(
        catalogue, roles, effects_at_most, negligible, odds, free_runs, interpolation, seed, settle
    )
    sampling = Sampling(draws, tune, chains, seed)
    with given_checkpoint(checkpoint, resume, checkpoint_every) as held, stages(progress):
        started = time.perf_counter()
        model = model.on(train)
        if test is not None:
            test = with_filter_of(test, train)
        if held is not None:
            # Checked first, as weighing takes long.
            held.require("study", run_facts(model, train, sampling, test=data_facts(test), **settings.weighing))
        found = investigate(model, train, test, settings, progress)
        study = _amended(model, found, train)
        if settle:
            study = _sampled(study, sampling, held, progress)
        seconds = {**study.settings["seconds"], "total": time.perf_counter() - started}
        return replace(study, settings={**study.settings, "seconds": seconds})


def _amended(model: GreyBox, found: StudyResult, train: Trajectories) -> Study:
    """Return a study whose extended model is a `GreyBox`, not sampled yet."""
    hidden = [state for amendment in found.amendments.values() for state in amendment.hidden]
    dictionary = found.model.dictionary
    # The study may have found how inputs behave between samples.
    amended = replace(
        model, rows=found.base.rows, dictionary=dictionary, noise=found.model.noise, parameters=found.model.parameters
    )
    amended = amended.along_parameters().remembering(hidden_used(dictionary, hidden), found.train)
    # Other states of the path that the study followed are not part of the answer.
    known = amended.states(train)
    states = {name: column for name, column in found.corrected.states.items() if name in known}
    return _study(found, model=amended, fit=None, corrected=replace(found.corrected, states=states))


def _sampled(study: Study, sampling: Sampling, checkpoint: Checkpoint | None, progress: bool) -> Study:
    """Return a study with the posterior of its extended model, or with the reason why there is none."""
    # The answer stands; sampling gives its coefficients their posterior.
    announce(f"{study.verdict.upper()}: {study.sentence}", answer=True)
    start = time.perf_counter()
    try:
        fit = study.model.fit(
            study.corrected, draws=sampling.draws, tune=sampling.tune, chains=sampling.chains, seed=sampling.seed,
            progress=progress, checkpoint=checkpoint,
        )  # fmt: skip
    except InputError as error:
        # The study's answer stands.
        if not study.model.rows.follows_path:
            raise
        study = replace(study, warnings=(*study.warnings, f"The extended model was not sampled. {error}"))
    else:
        # The fit may have been given more features.
        study = replace(study, fit=fit, model=replace(study.model, discrepancy=fit.model.discrepancy))
    seconds = {**study.settings["seconds"], "sample": time.perf_counter() - start}
    return replace(study, settings={**study.settings, "seconds": seconds})
