"""The ladder of evidence of a missing-effect study, rung by rung, each a section of its page."""

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import compress
from typing import Any

import pandas as pd

from bayes_greybox.discovery.answer.instrument import IN_MODEL, LISTED
from bayes_greybox.discovery.learned import studied_system
from bayes_greybox.discovery.sensor_errors.channels import DELAY
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.discovery.ties import sorted_by_probability
from bayes_greybox.physics.catalogue.names import listing
from bayes_greybox.report import plots as figures
from bayes_greybox.report.equations.text import as_simulation
from bayes_greybox.report.plots.gap.gap_map import SURE
from bayes_greybox.report.plots.studies import gap_parts
from bayes_greybox.report.words.doubts import NOTABLE
from bayes_greybox.report.words.formatting import (
    estimate,
    formula,
    interval,
    nats,
    number,
    numbers_in,
    percent_text,
    probability_text,
    quantity,
    share_text,
    unbroken,
)
from bayes_greybox.report.words.study import (
    LIKELY,
    added,
    closed_share,
    concentration,
    metric_interval,
    metric_value,
    metric_words,
    name_of,
    reversed_text,
    set_label,
    shown_part,
    suspect_size,
    suspects_weighed,
    whole_term,
)

from .free_run_section import free_run_section
from .page import Code, Details, Items, Picture, Pictures, Section, Table, Words, picture, time_picture
from .tables import by_equation, settings_table

MOST_TIED = 3
"""Effects that another is tied with, as the table names them."""

STATUS = {"added": "in the model", "one of": "could stand in its place", "": "–"}
"""What a status of an effect is called."""


def where(study: StudyResult) -> Section:
    """Gap maps, gap along time, regions and windows."""
    blocks: list[Any] = [Pictures(_maps(study, equation)) for equation in study.maps]
    blocks.append(_regions(study) if len(study.where) else Words("No region and no stretch of time stands out."))
    measured = study.train.target_in_words(*study.maps)
    lead = (
        f"The gap is what the measured {measured} has beyond the model: its posterior mean by colour, with a bold "
        "outline where it exceeds the threshold with probability 0.9. Colours reach to the threshold at "
        "least: what is pale is small beside the noise."
    )
    if any(len(gap_parts(study, name)) > 1 for name in study.maps):
        lead += " Before and after share one scale."
    if any(row["suspect"] == DELAY and row["status"] == IN_MODEL for row in study.instrument.to_dict("records")):
        lead += " Delays that are in the model are undone here, before and after."
    return Section("where", "Where simulation and measurement disagree", lead, blocks)


def what(study: StudyResult) -> Section:
    """Hypotheses and effects with their probabilities."""
    blocks: list[Any] = [
        Pictures([picture(figures.ranking(study, name), f"Probabilities of the hypotheses about {_rate(study, name)}")])
        for name in _equations(study.hypotheses)
    ]
    if len(study.effects):
        notable = (study.effects["status"] != "") | (study.effects["probability"] >= NOTABLE)
        effects: Any = study.effects
        shown, rest = effects[notable], effects[~notable]
        text = f"No effect of the catalogue is as probable as {probability_text(NOTABLE)}."
        blocks.append(_effects(study, shown) if len(shown) else Words(text))
        if len(rest):
            blocks.append(Details(f"{_counted(len(rest), 'less probable effect')}", [_effects(study, rest)]))
    if len(study.hypotheses):
        table = _hypotheses(study)
        blocks.append(Details("All hypotheses" if len(table.rows) > 1 else "The only hypothesis", [table]))
    if study.left_out:
        rows = [
            (name_of(study, slug), _rate(study, equation), reason)
            for (equation, slug), reason in study.left_out.items()
        ]
        left_out = _table(study, ("effect", "equation", "reason"), rows, "Effects that were not weighed, and why")
        blocks.append(Details(f"{_counted(len(rows), 'effect')} not weighed, and why", [left_out]))
    lead = (
        "Hypotheses are sets of effects, and what needs none; their probabilities sum to one. The probability of an "
        "effect is the sum over all sets that hold it; beside a rest that carries the share s of the gap a set counts "
        "with 1 − √s, as it may imitate what is unknown, and √s counts for “unknown”. “Gap left” is the share that no "
        "named physics explains under the hypothesis."
    )
    return Section("what", "What could be missing", lead, blocks)


def how_much(study: StudyResult) -> Section:
    """Coefficients of the added effects, and the amended simulation to copy."""
    blocks: list[Any] = [Words("No effect was added to the model.")]
    if added(study).size:
        alt = "Posterior distribution of the coefficient of each added effect"
        blocks = [Pictures([picture(figures.added_coefficients(study), alt)])]
    system = studied_system(study)
    text = as_simulation(system)
    if text and any(each.terms for each in system.learned.values()):
        caption = "The simulation with what was found, as at the top, for [simulation] of a configuration:"
        blocks.append(Code(text, caption))
    return Section("how-much", "How much of it", "", blocks)


def free_runs(study: StudyResult) -> Section | None:
    """Each state as measured, and as the models run it before and after."""
    if not study.paths:
        return None
    drawn = {state: partial(figures.free_run, study, state) for state in study.paths}
    part = "held-out data" if shown_part(study) == "test" else "training data"
    return free_run_section(
        "Does the simulation now follow the measurements?",
        f"Each model is started where the measurements start and then left alone, on the {part}.",
        drawn,
        [path.holds for path in study.paths.values()],
        shown="before and after, against the measurements",
    )


def gap_numbers(study: StudyResult) -> Section:
    """Every measure of the gap, held-out data first."""
    captions = {"test": "On held-out data", "train": "On the training data"}
    known = set(study.gap.index.get_level_values(0))
    blocks = [_gap(study, part, caption) for part, caption in captions.items() if part in known]
    lead = "Before and after are of the mean over the posterior draws, intervals of single draws."
    if "free-run NRMSE" in study.gap.index.get_level_values("metric"):
        lead += " Errors of single draws cancel in the mean of a free run, whose own may thus lie below its interval."
    if not added(study).size and study.verdict == "unknown":
        lead += " Nothing was named: what is lower after is taken up by f, which may have any shape."
    return Section("gap", "The gap in numbers", lead, blocks)


def sets(study: StudyResult) -> Section | None:
    """The likeliest set of each size, as bars and as a table."""
    if not len(study.rounds):
        return None
    alt = "Share of the gap that the likeliest set of each size leaves"
    shown = [picture(figures.rounds(study, name), f"{alt}, {_rate(study, name)}") for name in _equations(study.rounds)]
    known = study.hypotheses["probability"].to_dict()
    rows = [
        (
            _rate(study, equation),
            str(k - 1),
            set_label(study, row["verdict"]),
            # What is unknown has more than the sets without an effect: all that others may imitate.
            probability_text(known.get((equation, row["verdict"]), row["probability"])),
            share_text(row["share_left"]),
            name_of(study, row["runner_up"]) or "–",
            probability_text(known.get((equation, row["runner_up"]), row["runner_up_probability"])),
        )
        for (equation, k), row in _records(study.rounds)
    ]
    heads = ("equation", "#effects", "likeliest", "#probability", "#left by its columns", "runner-up")
    lead = (
        "Effects are weighed as sets: the likeliest one with no effect, with one, with two, and what the columns of "
        "each leave of the gap where they take all that they can. Beside a rest of any shape they may take less, which "
        "the “gap left” above counts. Effects that show only together are found together."
    )
    table = _table(study, (*heads, "#its probability"), rows, "The likeliest set of each size, and the runner-up")
    return Section("sets", "The likeliest sets of effects", lead, [Pictures(shown), table])


def measurement(study: StudyResult) -> Section:
    """Suspects about sensors and noise, and the odds that they were weighed with."""
    blocks: list[Any] = []
    if len(study.instrument):
        records = study.instrument.to_dict("records")
        rows = [
            (
                numbers_in(row["text"]),
                _rate(study, row["equation"]),
                probability_text(row["probability"]),
                row["suspect"],
                *suspect_size(row),
            )
            for row in records
        ]
        inside = [i for i, row in enumerate(records) if row["status"] == IN_MODEL]
        if not inside:
            blocks.append(Words("Nothing about the measurement was taken for true."))
        columns = ("what", "equation", "#probability", "kind", "#size", "#90 % interval", "#in samples")
        caption = f"Suspects with a probability of {percent_text(LISTED)} or more"
        caption += "; those in the model are marked" if inside else "; none is in the model"
        blocks.append(_table(study, columns, rows, caption, inside))
    else:
        text = f"Every suspect was weighed and found unlikely: each has a probability below {percent_text(LISTED)}."
        blocks.append(Words(text))
    odds = suspects_weighed(study)
    if odds:
        blocks.append(
            Details(
                "What was weighed, and with which prior odds",
                [Table(("suspect", "prior"), odds, "Prior probability and size of each suspect")],
            )
        )
    lead = (
        "Sensors and noise are suspects like effects: channels that are late, scaled, offset or bent, and noise that "
        "is correlated, varies with the state or has outliers. What is in the model is taken for true beside effects."
    )
    return Section("measurement", "The measurement", lead, blocks)


def corrections(study: StudyResult) -> Section | None:
    """Corrections to the simulation's own coefficients."""
    if not len(study.corrections):
        return None
    rows = [
        (
            formula(str(term)),
            _rate(study, equation),
            number(row["nominal"], 4),
            probability_text(row["probability"]),
            estimate(row["mean"], row["sd"], row["unit"]),
            interval(row["lower"], row["upper"]),
        )
        for (equation, term), row in _records(study.corrections)
    ]
    table = study.corrections
    likely, around = table["probability"] > LIKELY, (table["lower"] < 0.0) & (table["upper"] > 0.0)
    # What is likely there, but with no sign that the data tell, is no sure correction.
    spans = likely & (around | (table["sd"] > table["mean"].abs()))
    columns = ("`term", "equation", "#in the simulation", "#P(it is off)", "#correction", "#90 % interval")
    off, unclear, right = (list(compress(rows, kept)) for kept in (likely & ~spans, spans, ~likely))
    shown = {
        "Coefficients that are more likely off than not": off,
        "Coefficients that are corrected by what cannot be told from zero": unclear,
    }
    blocks: list[Any] = [_table(study, columns, some, title) for title, some in shown.items() if some]
    blocks = blocks or [Words("None of them is more likely off than not.")]
    if right:
        table = _table(study, columns, right, "Coefficients that are likely right")
        blocks.append(Details(f"{_counted(len(right), 'coefficient')} likely right", [table]))
    lead = "A coefficient of the simulation may be off: its correction is exactly zero unless the data say otherwise."
    return Section("corrections", "The simulation's own coefficients", lead, blocks)


def ties(study: StudyResult) -> Section | None:
    """Which effects these data cannot tell apart, and which experiment could."""
    if not study.ties:
        return None
    lead = "These data do not tell the following effects apart; the next experiment could."
    items = []
    for tie in study.ties:
        names = listing((name_of(study, slug) for slug in tie["slugs"]), " or ")
        items.append(
            (names if len(study.maps) == 1 else f"{names}, in {_rate(study, tie['equation'])}", str(tie["advice"]))
        )
    return Section("ties", "What would tell the candidates apart", lead, [Items(items)])


def settings(study: StudyResult, config: str | None) -> Section:
    """Settings, seed, versions, times and the configuration file, folded."""
    blocks = [Details("Settings, seed, versions and times", [settings_table(study.settings)])]
    if config:
        blocks.append(Details("Configuration file", [Code(config)]))
    return Section("settings", "How this was made", "", blocks)


def _maps(study: StudyResult, equation: str) -> list[Picture]:
    gap = study.maps[equation]
    over = f"Gap in {_rate(study, equation)} over {' and '.join(gap.variables)}"
    if len(gap.variables) == 2:
        parts = gap_parts(study, equation)
        shown = [picture(figures.gap_map(study, equation, (part,)), f"{over}, {part}") for part in parts]
    else:
        shown = [picture(figures.gap_map(study, equation), f"{over}, before and after")]
    if equation not in study.traces:
        return shown
    event = f"P(|gap| > {quantity(gap.threshold, gap.unit)}) > {SURE:g}"
    probability = study.traces[equation].probability
    sure = probability is not None and bool((probability > SURE).any())
    bars = f"Thick bars at the bottom: {event}" if sure else f"Nowhere is {event}"
    along = time_picture(
        lambda width: figures.gap_over_time(study, equation, width),
        f"Gap in {_rate(study, equation)} along the training data, before and after",
        f"Bands hold 90\u00a0%. {bars} for the simulation as given.",
    )
    return [*shown, along]


def _regions(study: StudyResult) -> Table:
    rows = [
        (
            unbroken(numbers_in(row["description"])),
            _rate(study, row["equation"]),
            probability_text(row["probability"]),
            share_text(row["gap_share"]),
            share_text(row["sample_share"]),
            concentration(row),
            row["kind"],
        )
        for row in study.where.to_dict("records")
    ]
    shares = ("#share of the gap", "#share of the samples", "#concentration")
    caption = "Regions of the state space and stretches of time that hold the gap"
    return _table(study, ("where", "equation", "#probability", *shares, "kind"), rows, caption)


def _effects(study: StudyResult, effects: pd.DataFrame) -> Table:
    records = effects.to_dict("records")
    several = "one of" in set(study.effects["status"])
    rows = [
        (
            f"{row['name']} ({turned})" if (turned := reversed_text(row)) else row["name"],
            _rate(study, row["equation"]),
            probability_text(row["probability"]),
            estimate(row["mean"], row["sd"], row["unit"]),
            interval(row["lower"], row["upper"]),
            formula(whole_term(row)),
            # What an improbable effect is tied with helps nobody.
            _tied(study, row["tied_with"]) if row["status"] or row["probability"] >= NOTABLE else "–",
            *([STATUS[row["status"]]] if several else []),
        )
        for row in records
    ]
    marked = [i for i, row in enumerate(records) if row["status"] == "added"]
    columns = ["effect", "equation", "#probability", "#coefficient", "#90 % interval", "`term", "tied with"]
    columns += ["status"] if several else []
    alone = "coefficients of the others are those that each would have alone"
    caption = "Effects of the catalogue, best first"
    if marked:
        caption += f"; those added to the model are marked, {alone}"
    return _table(study, columns, rows, caption, marked)


def _tied(study: StudyResult, slugs: Sequence[str]) -> str:
    names = [name_of(study, slug) for slug in slugs[:MOST_TIED]]
    more = [f"{len(slugs) - MOST_TIED} more"] if len(slugs) > MOST_TIED else []
    return listing([*names, *more], ", ") or "–"


def _hypotheses(study: StudyResult) -> Table:
    table = sorted_by_probability(study.hypotheses)
    rows = [
        (
            name_of(study, slug),
            _rate(study, equation),
            probability_text(row["probability"]),
            nats(row["log_evidence"], 2),
            share_text(row["share_left"]),
        )
        for (equation, slug), row in _records(table)
    ]
    heads = ("hypothesis", "equation", "#probability", "#log evidence [nat]", "#gap left")
    return _table(study, heads, rows, "Every hypothesis, best first")


def _gap(study: StudyResult, part: str, caption: str) -> Table:
    rows = [
        (
            metric_words(study, metric, str(variable))[0],
            metric_value(study, metric, row["before"]),
            metric_value(study, metric, row["after"]),
            closed_share(row["closed"]),
            metric_interval(study, metric, row["lower"], row["upper"]),
        )
        for (metric, variable), row in _records(study.gap.xs(part, level=0))
    ]
    return Table(("measure", "#before", "#after", "#closed", "#90 % interval of after"), rows, caption)


def _table(study: StudyResult, columns: Any, rows: Any, caption: str = "", marked: Any = ()) -> Table:
    return by_equation(columns, rows, list(study.maps), caption, marked)


def _counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _records(table: pd.DataFrame) -> Iterator[tuple[Any, dict[Any, Any]]]:
    """Index and row of a table, one after the other."""
    return zip(table.index, table.to_dict("records"), strict=True)


def _equations(table: pd.DataFrame) -> list[str]:
    return list(dict.fromkeys(table.index.get_level_values(0)))


def _rate(study: StudyResult, equation: Any) -> str:
    return study.train.target_label(equation)
