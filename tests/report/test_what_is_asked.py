"""Requests of a study to its reader, from tables that are written down by hand."""

import numpy as np
import pandas as pd
import pytest
from test_sentence import CORRELATED, DOUBTED, OPEN, made

from bayes_greybox.discovery.answer.instrument import IN_MODEL
from bayes_greybox.discovery.decision import reasons
from bayes_greybox.discovery.decision.decide import VERDICTS
from bayes_greybox.discovery.decision.reasons import Reason
from bayes_greybox.discovery.study import NO_CATALOGUE
from bayes_greybox.report.words.asked import DOUBT_TEXTS, asked

FARTHER = "To tell them apart, measure up to |v| = 2.7 m/s (the data reach 1.3): there they differ."


def to_do(verdict, *given, ties=(), file="run/study.nc", places=(), **changes):
    """Texts and commands, with spaces that break."""
    study = made(verdict, *given, **changes)
    where = pd.DataFrame(places, columns=["equation", "kind", "description", "sample_share"])
    study.__dict__.update(ties=list(ties), explanations={"x": ()}, where=where)
    study.settings["configuration"] = "trolley.toml"
    return [(each.text.replace("\u00a0", " "), each.command) for each in asked(study, file)]


def sensor(suspect, mean, unit="", text="it is off", channel="a", status=IN_MODEL):
    row = {"suspect": suspect, "channel": channel, "mean": mean, "unit": unit, "status": status, "text": text}
    return pd.DataFrame([{"equation": "x", "probability": 0.99, **row}])


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_asks_for_something(verdict):
    added = [("Drag", 0.97, ())] if verdict in ("named", "partly named", "one of") else []
    found = to_do(verdict, added, y=(1.0, 0.97, 0.25))
    assert found and all(text.endswith(".") and text[0].isupper() for text, _ in found)


def test_what_is_named_is_exported_and_what_agrees_is_left():
    assert to_do("named", [("Drag", 0.97, ())]) == [
        (
            "Add what was found to the simulation, and use it within the range of these data.",
            "bayes-greybox export run/study.nc amended.c",
        )
    ]
    assert to_do("named", [("Drag", 0.97, ())], file="")[0][1] == 'study.export("amended.c")'
    assert to_do("named", [("Drag", 0.97, ())], file="my runs/study.nc")[0][1].split(" ", 2)[2].startswith("'my runs/")
    ((text, command),) = to_do("no gap")
    assert text.startswith("Nothing: go on with the simulation as it is") and not command


def test_what_goes_with_time_is_asked_for_by_its_times():
    places = [
        ("x", "region", "v > 1 m/s", 0.2),
        ("x", "window", "t = 0 to 30 s", 0.7), ("x", "window", "t = 10.4 to 15.6 s", 0.2),
    ]  # fmt: skip
    (text, command), (shape, _) = to_do("unknown", memory={"x": {"something in time": 0.999}}, places=places)
    assert text.startswith("Find out what happened at t = 10.4 to 15.6 s: no column records what acted on the machine")
    assert not command and shape.startswith("Look at the shape of the gap")
    law = to_do("unknown", memory={"x": {"a law of the states": 0.999}}, places=places)
    assert [text for text, _ in law] == [shape]


def test_the_experiment_that_would_decide_is_said_with_its_figure():
    tie = {"equation": "x", "slugs": ("smooth-friction", "quadratic-drag"), "advice": FARTHER}
    assert to_do("one of", OPEN, ties=[tie]) == [(FARTHER, "bayes-greybox next run/study.nc")]
    assert to_do("one of", OPEN, ties=[tie], file="")[0][1] == "study.next_experiment()"
    two = to_do("one of", OPEN, ties=[tie, {**tie, "slugs": ("a", "b"), "advice": "show the sensor a motion"}])
    assert [text for text, _ in two] == [
        FARTHER.replace("them apart", "smooth friction from quadratic drag"),
        "To tell A from B: show the sensor a motion.",
    ]  # fmt: skip
    assert to_do("one of", OPEN)[0][0] == "More data of the same kind, or less noise."


def test_parameters_and_coefficients_are_set_and_the_file_studied_again():
    again = "bayes-greybox discover trolley.toml"
    study = made("recalibrate", y=(1.0, 0.97, 0.25))
    study.__dict__.update(ties=[], explanations={})
    study.settings["configuration"] = "trolley.toml"
    (each,) = asked(study, "study.nc")
    assert (each.text, each.command) == (
        "Set the coefficient of y in d(x)/dt to 1.250 ± 0.050 1/s; the simulation has 1.", again
    )  # fmt: skip
    study.__dict__["corrections"] = study.corrections.assign(parameter=True)
    assert asked(study, "study.nc")[0].text == "Set y to 1.250 ± 0.050 1/s; the simulation has 1."
    study.__dict__["corrections"] = study.corrections.assign(probability=0.3)
    assert asked(study, "study.nc")[0].text.startswith("Measure the parameters that may be off by themselves")


@pytest.mark.parametrize(
    ("row", "how"),
    [
        (sensor("delay", 0.009, "s"), "move a by 0.009 s to earlier times, against the other columns"),
        (
            sensor("delay", -0.009, "s", channel="states"),
            "move all states by 0.009 s to later times, against the other columns",
        ),
        (sensor("gain", 0.02), "divide a by 1.02"),
        (sensor("offset", 0.3, "m"), "take 0.3 m off a"),
        (sensor("offset", -0.3, "m"), "add 0.3 m to a"),
        (sensor("cubic error", 0.3), "calibrate the sensor of a"),
    ],
)
def test_a_sensor_is_corrected(row, how):
    said = f"Correct the measurement: {how}."
    assert to_do("instrument", table=row) == [(said, "bayes-greybox discover trolley.toml")]
    # Beside an effect as well, and never what is not taken for true.
    assert said in [text for text, _ in to_do("named", [("Drag", 0.97, ())], table=row)]
    assert said not in [text for text, _ in to_do("instrument", table=row.assign(status=""))]


def test_noise_is_allowed_for():
    row = sensor("heavy tails", 3.0)
    assert to_do("instrument", table=row)[0][0].startswith("Leave the simulation as it is, and allow for the noise")


def test_each_reason_against_a_verdict_asks_for_something_of_its_own():
    codes = [value for name, value in vars(reasons).items() if name.isupper() and isinstance(value, str)]
    assert set(DOUBT_TEXTS) == set(codes) and len(set(DOUBT_TEXTS.values())) == len(codes)
    texts = [text for text, _ in to_do("partly named", OPEN[:1], against=[CORRELATED, CORRELATED, DOUBTED])]
    assert texts == [f"{DOUBT_TEXTS[code]}." for code in (reasons.CHECK, reasons.ONE_LAW)]
    unseen = Reason(reasons.UNSEEN_SHAPE, "rates do not show it", "x")
    assert to_do("partly named", OPEN[:1], against=[unseen])[0][1] == '[rows] kind = "trajectory"'
    # Nothing is left alone that its own checks contradict.
    held_out = Reason(reasons.HELD_OUT, "held-out samples are left", "x")
    assert to_do("no gap", against=[held_out]) == [(f"{DOUBT_TEXTS[reasons.HELD_OUT]}.", "")]


def test_what_has_no_name_asks_for_effects_and_for_roles():
    lacking = {
        **dict.fromkeys([("x", "cubic"), ("z", "cubic"), ("x", "sine")], "position"),
        ("x", "g"): "other_position",
    }
    (shape, command), (role, _) = to_do("unknown", lacking=lacking)
    assert (
        shape.startswith("Look at the shape of the gap")
        and command == '[study] catalogue = ["mechanical", "mine.toml"]'
    )
    assert role == (
        "2 effects were not weighed: no column plays the role 'position'; give roles={'position': \"COLUMN\"}, in a "
        'file position = "COLUMN" under [study.roles].'
    )
    assert to_do("unknown", catalogue=NO_CATALOGUE) == [
        ("Weigh effects of a catalogue.", '[study] catalogue = "mechanical"')
    ]
    assert "not weighed" not in str(to_do("named", [("Drag", 0.97, ())], lacking=lacking))


def test_the_rest_beside_names_is_looked_at():
    assert to_do("partly named", OPEN[:1])[0][0].startswith("Do not build on the name alone")
    assert np.all([not command.startswith("bayes") for _, command in to_do("partly named", OPEN[:1])])
