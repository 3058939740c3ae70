"""The ladder of evidence of a missing-effect study, rung by rung, each a section of its page."""

from functools import partial
from typing import Any

import pandas as pd

from bayes_greybox.discovery.answer.instrument import IN_MODEL, LISTED
from bayes_greybox.discovery.contradictions import findings, notable
from bayes_greybox.discovery.learned import shown_corrections, shown_effects, studied_system
from bayes_greybox.discovery.sensor_errors.channels import DELAY
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.discovery.summary import added, changed, shown_part, unclear_sign
from bayes_greybox.discovery.ties import sorted_by_probability
from bayes_greybox.physics.catalogue.names import listing
from bayes_greybox.report import plots as figures
from bayes_greybox.report.equations.text import as_simulation
from bayes_greybox.report.pages.shared import free_run_section
from bayes_greybox.report.plots.gap.gap_map import SURE_GAP
from bayes_greybox.report.plots.studies import gap_parts
from bayes_greybox.report.tables import Table, records_of, table_of
from bayes_greybox.report.words import formatting as fmt
from bayes_greybox.report.words import study as words
from bayes_greybox.report.words.asked import STUDY_FILE, asked
from bayes_greybox.report.words.doubts import doubts

from .page import Code, Details, Picture, Pictures, Section, Words, picture, time_picture

ADOPTED = ("named", "recalibrate")
"""Verdicts that ask to take over what was found."""


def to_do(study: StudyResult) -> Section:
    """Return the section of what the verdict asks of the reader, with commands and the simulation to copy."""
    # A page of the command line lies beside the study's file.
    blocks: list[Any] = []
    for each in asked(study, STUDY_FILE if "configuration" in study.settings else ""):
        blocks += [Words(fmt.unbroken(each.text)), *([Code(each.command)] if each.command else [])]
    return Section("to-do", "What to do now", "", blocks + (_simulation(study) if study.verdict in ADOPTED else []))


def _simulation(study: StudyResult) -> list[Code]:
    """Return the extended simulation to copy; nothing where it has code, or nothing was found."""
    system = studied_system(study)
    text = as_simulation(system)
    if not text or not any(each.terms for each in system.learned.values()):
        return []
    return [Code(text, "The simulation with what was found, as at the top, for [simulation] of a configuration:")]


def where(study: StudyResult) -> Section:
    """Return the section of gap maps, gap along time, regions and windows."""
    blocks: list[Any] = [Pictures(_maps(study, equation)) for equation in study.maps]
    if len(study.where):
        columns = {
            "where": lambda row: fmt.unbroken(fmt.numbers_in(row["description"])),
            "equation": lambda row: _rate(study, row["equation"]),
            "#probability": lambda row: fmt.probability_text(row["probability"]),
            "#share of the gap": lambda row: fmt.share_text(row["gap_share"]),
            "#share of the samples": lambda row: fmt.share_text(row["sample_share"]),
            "#concentration": words.concentration,
            "kind": lambda row: row["kind"],
        }
        caption = "Regions of the state space and stretches of time that hold the gap"
        blocks.append(_table(study, study.where, columns, caption))
    else:
        blocks.append(Words("No region and no stretch of time stands out."))
    measured = study.train.target_in_words(*study.maps)
    lead = (
        f"The gap is what the measured {measured} has beyond the model: its posterior mean by colour, with a bold "
        "outline where it exceeds the threshold with probability 0.9. Colours reach to the threshold at "
        "least: what is pale is small beside the noise."
    )
    if any(map(changed, study.maps.values())):
        lead += " Before and after share one scale."
    if any(row["suspect"] == DELAY and row["status"] == IN_MODEL for row in study.instrument.to_dict("records")):
        lead += " Delays that are in the model are undone here, before and after."
    return Section("where", "Where simulation and measurement disagree", lead, blocks)


def what(study: StudyResult) -> Section:
    """Return the section of hypotheses and effects with their probabilities."""
    blocks: list[Any] = [
        Pictures([picture(figures.ranking(study, name), f"Probabilities of the hypotheses about {_rate(study, name)}")])
        for name in study.hypotheses.index.unique(0)
    ]
    if len(study.effects):
        likely = (study.effects["status"] != "") | (study.effects["probability"] >= notable(study))
        effects: Any = shown_effects(study)
        shown, rest = effects[likely], effects[~likely]
        text = f"No effect of the catalogue is as probable as {fmt.probability_text(notable(study))}."
        blocks.append(_effects(study, shown) if len(shown) else Words(text))
        if len(rest):
            blocks.append(Details(fmt.counted(len(rest), "less probable effect"), [_effects(study, rest)]))
    if len(study.hypotheses):
        columns = {
            "hypothesis": lambda row: words.name_of(study, row["hypothesis"]),
            "equation": lambda row: _rate(study, row["equation"]),
            "#P by itself": lambda row: fmt.probability_text(row["probability"]),
            "#log evidence [nat]": lambda row: fmt.nats(row["log_evidence"], 2),
            "#gap left": lambda row: fmt.share_text(row["share_left"]),
        }
        table = _table(study, sorted_by_probability(study.hypotheses), columns, "Every hypothesis, best first")
        blocks.append(Details("All hypotheses" if len(table.rows) > 1 else "The only hypothesis", [table]))
    if study.left_out:
        columns = {
            "effect": lambda item: words.name_of(study, item[0][1]),
            "equation": lambda item: _rate(study, item[0][0]),
            "reason": lambda item: item[1],
        }
        caption = "Effects that were not weighed, and why"
        left_out = table_of(study.left_out.items(), columns, caption, equations=list(study.maps))
        blocks.append(Details(f"{fmt.counted(len(study.left_out), 'effect')} not weighed, and why", [left_out]))
    lead = (
        "Hypotheses are sets of effects, and what needs none; their probabilities sum to one. The probability of an "
        "effect is the sum over all sets that hold it. Beside a discrepancy without a name a set counts with the share "
        "of the gap that it closes, as it may imitate what is unknown; the other share counts for “unknown”. “Gap "
        "left” is the share that no named physics explains under the hypothesis."
    )
    return Section("what", "What could be missing", lead, blocks)


def how_much(study: StudyResult) -> Section | None:
    """Return the section of the coefficients of the added effects, and of the extended simulation to copy."""
    alt, blocks = "Posterior distribution of the coefficient of each added effect", []
    if added(study).size:
        blocks.append(Pictures([picture(figures.added_coefficients(study), alt)]))
    if study.verdict not in ADOPTED:
        blocks += _simulation(study)
    return Section("how-much", "How much of it", "", blocks, folded=True) if blocks else None


def free_runs(study: StudyResult) -> Section | None:
    """Return the section of each state as measured, and as the models run it before and after."""
    if not study.paths:
        return None
    part = "held-out data" if shown_part(study) == "test" else "training data"
    codes = [each.code for each in findings(study)]
    found = " ".join(f"{each.text}." for code, each in zip(codes, doubts(study), strict=True) if code == "free run")
    return free_run_section(
        f"Does the simulation {'now ' if any(map(changed, study.maps.values())) else ''}follow the measurements?",
        f"{found} Each model is started where the measurements start and then left alone, on the {part}.".lstrip(),
        {state: partial(figures.free_run, study, state) for state in study.paths},
        [path.holds for path in study.paths.values()],
        shown="before and after, against the measurements",
    )


def gap_numbers(study: StudyResult) -> Section:
    """Return the section of every measure of the gap, held-out data first."""
    blocks, parts = [], study.gap.index.unique(0)
    for part, caption in {"test": "On held-out data", "train": "On the training data"}.items():
        columns = {
            "measure": lambda row: words.metric_words(study, row["metric"], str(row["variable"]))[0],
            "#before": lambda row: words.metric_value(study, row["metric"], row["before"]),
            "#after": lambda row: words.metric_value(study, row["metric"], row["after"]),
            f"#{words.closed_heading(study)}": partial(words.closed_cell, study, part),
            "#90 % interval of after": lambda row: words.metric_interval(
                study, row["metric"], row["lower"], row["upper"]
            ),
        }
        blocks += [_table(study, study.gap.xs(part, level=0), columns, caption)] if part in parts else []
    lead = "Before and after are of the mean over the posterior draws, intervals of single draws."
    if "free-run NRMSE" in study.gap.index.get_level_values("metric"):
        lead += " Errors of single draws cancel in the mean of a free run, whose own may thus lie below its interval."
    if not added(study).size and study.verdict == "unknown":
        lead += " Nothing was named: what is lower after is taken up by f, which may have any shape."
    return Section("gap", "The gap in numbers", lead, blocks, folded=True)


def measurement(study: StudyResult) -> Section:
    """Return the section of suspects about sensors and noise, and of the odds that they were weighed with."""
    taken, least = IN_MODEL in set(study.instrument["status"]), fmt.percent_text(LISTED)
    blocks: list[Any] = []
    if len(study.instrument):
        columns = {
            "what": lambda row: fmt.numbers_in(row["text"]),
            "equation": lambda row: _rate(study, row["equation"]),
            "#probability": lambda row: fmt.probability_text(row["probability"]),
            "kind": lambda row: row["suspect"],
            "#size": lambda row: words.suspect_size(row)[0],
            "#90 % interval": lambda row: words.suspect_size(row)[1],
            "#in samples": lambda row: words.suspect_size(row)[2],
        }
        blocks += [] if taken else [Words("Nothing about the measurement was taken for true.")]
        where = "those in the model are marked" if taken else "none is in the model"
        caption = f"Suspects with a probability of {least} or more; {where}"
        blocks.append(_table(study, study.instrument, columns, caption, lambda row: row["status"] == IN_MODEL))
    else:
        blocks.append(Words(f"Every suspect was weighed and found unlikely: each has a probability below {least}."))
    if odds := words.suspects_weighed(study):
        table = Table(("suspect", "prior"), odds, "Prior probability and size of each suspect")
        blocks.append(Details("What was weighed, and with which prior odds", [table]))
    lead = (
        "Sensors and noise are suspects like effects: channels that are late, scaled, offset or bent, and noise that "
        "is correlated, varies with the state or has outliers. What is in the model is taken for true beside effects."
    )
    return Section("measurement", "The measurement", lead, blocks, folded=not taken)


def corrections(study: StudyResult) -> Section | None:
    """Return the section of corrections to the simulation's own coefficients."""
    table: Any = shown_corrections(study)
    if not len(table):
        return None
    columns = {
        "`term": lambda row: fmt.formula(str(row["term"])),
        "equation": lambda row: _rate(study, row["equation"]),
        "#in the simulation": lambda row: fmt.number(row["nominal"], 4),
        "#P(it is off)": lambda row: fmt.probability_text(row["probability"]),
        "#correction": lambda row: fmt.estimate(row["mean"], row["sd"], row["unit"]),
        "#90 % interval": lambda row: fmt.interval(row["lower"], row["upper"]),
    }
    likely, unclear = table["probability"] > study.criteria.missing, unclear_sign(study.corrections)
    shown = {
        "Coefficients that are more likely off than not": table[likely & ~unclear],
        "Coefficients that are corrected by what cannot be told from zero": table[likely & unclear],
    }
    blocks: list[Any] = [_table(study, some, columns, title) for title, some in shown.items() if len(some)]
    blocks = blocks or [Words("None of them is more likely off than not.")]
    if len(right := table[~likely]):
        folded = _table(study, right, columns, "Coefficients that are likely right")
        blocks.append(Details(f"{fmt.counted(len(right), 'coefficient')} likely right", [folded]))
    lead = "A coefficient of the simulation may be off: its correction is exactly zero unless the data say otherwise."
    return Section("corrections", "The simulation's own coefficients", lead, blocks, folded=not likely.any())


def _maps(study: StudyResult, equation: str) -> list[Picture]:
    gap = study.maps[equation]
    over = f"Gap in {_rate(study, equation)} over {' and '.join(gap.variables)}"
    if len(gap.variables) == 1:
        shown = [picture(figures.gap_map(study, equation), f"{over}, before and after")]
    else:
        parts = gap_parts(study, equation)
        shown = [picture(figures.gap_map(study, equation, (part,)), f"{over}, {part}") for part in parts]
    if equation not in study.traces:
        return shown
    event = f"P(|gap| > {fmt.quantity(gap.threshold, gap.unit)}) > {SURE_GAP:g}"
    probability = study.traces[equation].probability
    sure = probability is not None and bool((probability > SURE_GAP).any())
    bars = f"Thick bars at the bottom: {event}" if sure else f"Nowhere is {event}"
    along = time_picture(
        lambda width: figures.gap_over_time(study, equation, width),
        f"Gap in {_rate(study, equation)} along the training data, before and after",
        f"Bands hold 90\u00a0%. {bars} for the simulation as given.",
    )
    return [*shown, along]


def _effects(study: StudyResult, effects: pd.DataFrame) -> Table:
    def name(row: Any) -> str:
        return f"{row['name']} ({turned})" if (turned := words.reversed_text(row)) else row["name"]

    def tied(row: Any) -> str:
        # What an improbable effect is tied with helps nobody.
        slugs = row["tied_with"] if row["status"] or row["probability"] >= notable(study) else ()
        more = [f"{len(slugs) - 3} more"] if len(slugs) > 3 else []
        return listing([*(words.name_of(study, slug) for slug in slugs[:3]), *more], ", ") or "–"

    columns = {
        "effect": name,
        "equation": lambda row: _rate(study, row["equation"]),
        "#probability": lambda row: fmt.probability_text(row["probability"]),
        "#coefficient": lambda row: fmt.estimate(row["mean"], row["sd"], row["unit"]),
        "#90 % interval": lambda row: fmt.interval(row["lower"], row["upper"]),
        "`term": lambda row: fmt.formula(words.whole_term(row)),
        "tied with": tied,
    }
    if "one of" in set(study.effects["status"]):
        status = {"added": "in the model", "one of": "could stand in its place", "": "–"}
        columns["status"] = lambda row: status[row["status"]]
    caption = "Effects of the catalogue, best first"
    if "added" in set(effects["status"]):
        caption += (
            "; those added to the model are marked, coefficients of the others are those that each would have alone"
        )
    return _table(study, effects, columns, caption, lambda row: row["status"] == "added")


def _table(study: StudyResult, rows: pd.DataFrame, columns: Any, caption: str, marked: Any = None) -> Table:
    return table_of(records_of(rows), columns, caption, marked, list(study.maps))


def _rate(study: StudyResult, equation: Any) -> str:
    return study.train.target_label(equation)
