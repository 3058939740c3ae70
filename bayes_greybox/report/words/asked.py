"""Words for what a study asks of its reader, with the command for it: the same for page, terminal and record."""

import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bayes_greybox.discovery import requests as codes
from bayes_greybox.discovery.decision import reasons
from bayes_greybox.discovery.requests import Request, requests
from bayes_greybox.discovery.sensor_errors.channels import DELAY, GAIN, NOISE, OFFSET
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.physics.catalogue.names import within

from .doubts import role_text
from .formatting import estimate, formula, listed, number, numbers_in, quantity
from .study import name_of

STUDY_FILE = "study.nc"
"""File that the command line keeps a study in, beside its page and its record."""

PLAIN_TEXTS = {
    codes.KEEP: "Nothing: go on with the simulation as it is, within the range of these data",
    codes.TRY: "Check it on a second record: no data were held out",
    codes.ADOPT: "Add what was found to the simulation, and use it within the range of these data",
    codes.CHOOSE: "Measure the parameters that may be off by themselves, and set the one that is",
    codes.ALLOW: "Leave the simulation as it is, and allow for the noise in whatever is fitted to these data",
    codes.REST: "Do not build on the name alone: look at the shape of what is left, and weigh effects of your own",
    codes.SHAPE: "Look at the shape of the gap, and weigh effects of your own beside the catalogue",
    codes.WEIGH: "Weigh effects of a catalogue",
}
"""Words for requests without values."""

DOUBT_TEXTS = {
    reasons.ONE_LAW: "Use what was added as one curve, and none of its names",
    reasons.ONE_LAW_AND_MORE: "Use what was added as one curve, none of its names, and look at the shape of the rest",
    reasons.UNSEEN_SHAPE: "Give the samples in the place of filtered rates: they show where an effect jumps",
    reasons.CHECK: "Do not rely on coefficients and intervals yet: a check of what is left failed",
    reasons.ROWS: "Mend the rows first, as is said of them below",
    reasons.END_OF_RANGE: "Widen the range of the nonlinear parameter in a catalogue of your own",
    reasons.NOT_COMPARED: "Hold out data that the extended model can follow",
    reasons.WORSE_RUN: "Do not simulate with it yet: left alone it follows the measurements worse than before",
    reasons.HELD_OUT: "Find out what is different about the held-out data, such as a sensor, a start or a load",
}
"""Words for requests to heed a reason against a verdict, by its code."""

CATALOGUE = 'catalogue = ["mechanical", "mine.toml"]'
"""Key of a configuration, and argument, that weighs a user's effects."""


@dataclass(frozen=True)
class Asked:
    """One thing to do, in words, with the command for it; "" if there is none."""

    text: str
    command: str = ""


def asked(study: StudyResult, file: str = "") -> list[Asked]:
    """Return what a study asks of its reader; `file` is where it is saved, or "" for calls in Python."""
    return [_in_words(study, each, shlex.quote(file) if file else "") for each in requests(study)]


def _in_words(study: StudyResult, request: Request, file: str) -> Asked:
    values = request.values
    match request.code:
        case codes.DOUBT:
            samples = '[rows] kind = "trajectory"' if file else "rows=bg.TrajectoryRows()"
            unseen = values["reason"] == reasons.UNSEEN_SHAPE
            return Asked(f"{DOUBT_TEXTS[values['reason']]}.", samples if unseen else "")
        case codes.TELL_APART:
            command = f"bayes-greybox next {file}" if file else "study.next_experiment()"
            return Asked(_experiment(study, values), command if values["ranked"] else "")
        case codes.SET:
            return Asked(_set(study, values["row"]), _again(study))
        case codes.CORRECT:
            return Asked(_correct(values["row"]), _again(study))
        case codes.EVENT:
            when = listed([numbers_in(each) for each in values["when"]])
            unseen = "no column records what acted on the machine, or disturbed its sensor"
            return Asked(f"Find out what happened at {when}: {unseen}.")
        case codes.ROLE:
            return Asked(f"{role_text(**values)}.")
    commands = {
        codes.ADOPT: f"bayes-greybox export {file} amended.c" if file else 'study.export("amended.c")',
        codes.REST: f"[study] {CATALOGUE}" if file else CATALOGUE,
        codes.SHAPE: f"[study] {CATALOGUE}" if file else CATALOGUE,
        codes.WEIGH: '[study] catalogue = "mechanical"' if file else 'catalogue="mechanical"',
    }
    return Asked(f"{PLAIN_TEXTS[request.code]}.", commands.get(request.code, ""))


def _experiment(study: StudyResult, tie: Mapping[str, Any]) -> str:
    advice = str(tie["advice"])
    if len(study.ties) > 1:
        names = " from ".join(within(name_of(study, slug)) for slug in tie["slugs"])
        advice = advice.replace("To tell them apart", f"To tell {names}")
        advice = advice if names in advice else f"To tell {names}: {advice[:1].lower()}{advice[1:]}"
    return f"{advice[:1].upper()}{advice[1:].removesuffix('.')}."


def _again(study: StudyResult) -> str:
    config = study.settings.get("configuration", "")
    return f"bayes-greybox discover {shlex.quote(config)}" if config else ""


def _set(study: StudyResult, row: Mapping[str, Any]) -> str:
    now = estimate(row["nominal"] + row["mean"], row["sd"], row["unit"])
    what = str(row["term"])
    if not row.get("parameter"):
        what = f"the coefficient of {formula(what)} in {study.train.target_label(row['equation'])}"
    return f"Set {what} to {now}; the simulation has {number(row['nominal'], 4)}."


def _correct(row: Mapping[str, Any]) -> str:
    channel, mean = "all states" if row["channel"] == "states" else row["channel"], float(row["mean"])
    size = quantity(abs(mean), row["unit"], 3)
    match row["suspect"]:
        case suspect if suspect == DELAY:
            size = estimate(abs(mean), row["sd"], row["unit"]) if math.isfinite(row.get("sd", math.nan)) else size
            how = f"move {channel} by {size} to {'earlier' if mean > 0 else 'later'} times, against the other columns"
        case suspect if suspect == GAIN:
            how = f"divide {channel} by {number(1 + mean, 4)}"
        case suspect if suspect == OFFSET:
            how = f"take {size} off {channel}" if mean > 0 else f"add {size} to {channel}"
        case suspect if suspect == NOISE:
            how = f"smooth {channel}, whose samples have noise of {size}, or filter it before it is sampled"
        case _:
            how = f"calibrate the sensor of {channel}"
    return f"Correct the measurement: {how}."
