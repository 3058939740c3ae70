"""The verdict in one sentence, from tables that are written down by hand."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.equation_study import KINDS_IN_WORDS
from bayes_greybox.discovery.answer.instrument import IN_MODEL
from bayes_greybox.discovery.decision import decide
from bayes_greybox.discovery.decision.reasons import CHECK, ONE_LAW, UNSEEN_SHAPE, Reason
from bayes_greybox.discovery.decision.vetoes import NAMES_ALONE
from bayes_greybox.discovery.study import NO_CATALOGUE, StudyResult
from bayes_greybox.discovery.summary import probability_missing
from bayes_greybox.report.words.sentence import headline, sentence

INDEX = ["data", "metric", "variable"]


def gap_table(run=(9.0, 0.1, 0.1), **parts):
    """Unexplained shares before and after by part, beside a free run's error before, after, and its lower end."""
    rows = {}
    for part, (before, after) in parts.items():
        rows[(part, "unexplained share", "x")] = (before, after, after)
        rows[(part, "free-run NRMSE", "x")] = run
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["before", "after", "lower"])
    table.index = pd.MultiIndex.from_tuples(table.index, names=INDEX)
    return table


CLOSED = gap_table(test=(0.4, 0.1))


CORRELATED = Reason(CHECK, "residuals hang together over 0.4 s", "x")
DOUBTED = Reason(ONE_LAW, decide.ONE_LAW_IN_WORDS, "x")
FRICTION = [("Coulomb friction", 0.5, ()), ("Viscous damping", 0.36, ())]


def test_what_may_be_one_law_is_said_as_a_law_of_its_quantity():
    text = said("partly named", FRICTION, against=[DOUBTED], law=0.99)
    assert text.startswith(
        "The simulation lacks a law of v in d(x)/dt (probability 0.990; Coulomb friction 0.500 and viscous damping "
        "0.360 together, or one without a name); adding it closes"
    )
    # Where nobody doubts that these are two laws, or where it is not sure that there is one, each has its own.
    for against, law in (((), 0.99), ([DOUBTED], 0.6)):
        assert "Coulomb friction in d(x)/dt (probability 0.500)" in said(
            "partly named", FRICTION, against=against, law=law
        )


def test_a_doubt_of_the_shape_alone_does_not_say_that_something_is_left():
    shape = Reason(UNSEEN_SHAPE, "rates that a filter computed do not show how it is where it jumps", "x")
    one = [("Coulomb friction", 0.98, ())]
    assert "that is not all" not in said("partly named", one, against=[shape])
    assert "that is not all" in said("partly named", one, against=[shape, CORRELATED])


def effects(*rows, equation="x"):
    """(name, probability, tied with, status if not added) of each effect, and one that was not added."""
    table = [(equation, name, p, tied, *(status or ["added"])) for name, p, tied, *status in rows]
    table.append(("x", "Diode", 0.3, (), ""))
    made = pd.DataFrame(table, columns=["equation", "name", "probability", "tied_with", "status"])
    return made.assign(slug=made["name"].str.lower().str.replace(" ", "-"))


def instrument(*texts):
    """What is in the model of the measurement, and a suspect that is not."""
    table = [*((text, IN_MODEL) for text in texts), ("u is 9 s late", "")]
    return pd.DataFrame(table, columns=["text", "status"])


def corrections(**given):
    """(nominal, probability, mean change) by term, known to a tenth of a unit."""
    table = pd.DataFrame.from_dict(given, orient="index", columns=["nominal", "probability", "mean"])
    table["lower"], table["upper"] = table["mean"] - 0.09, table["mean"] + 0.09
    table["sd"], table["unit"] = 0.05, "1/s"
    table.index = pd.MultiIndex.from_product([["x"], table.index], names=["equation", "term"])
    return table


def likeliest(**rows):
    """The likeliest explanation of each equation."""
    index = pd.MultiIndex.from_tuples(list(rows.items()), names=["equation", "hypothesis"])
    return pd.DataFrame({"probability": [0.99] * len(rows)}, index=index)


def remembers(**given):
    """Probability of what remembers, by equation and what it is."""
    rows = [(name, what, p) for name, table in given.items() for what, p in table.items()]
    table = pd.DataFrame(rows, columns=["equation", "memory", "probability"]).set_index(["equation", "memory"])
    whole = {text: kind for kind, text in KINDS_IN_WORDS.items()}
    kinds = [(whole[what], "") if what in whole else tuple(what.split(" of ", 1)) for _, what, _ in rows]
    return table.assign(kind=[kind for kind, _ in kinds], channel=[channel for _, channel in kinds])


TRAIN = Trajectories.from_arrays(np.arange(3.0), states={"x": np.arange(3.0)}, outputs={"R": np.ones(3)})
"""Data with a state and an output."""


def made(
    verdict, added=(), gap=CLOSED, measured=(), against=(), where="x", equations=None, lacking=(), memory=None,
    law=None, same=None, rest=None, reverse=None, catalogue="mechanical", table=None, **off
):  # fmt: skip
    study = object.__new__(StudyResult)
    equations = equations or {"x": verdict}
    study.__dict__.update(
        verdict=verdict, effects=effects(*added, equation=where), gap=gap, corrections=corrections(**off),
        instrument=instrument(*measured) if table is None else table, reasons=tuple(against),
        against=tuple(reason.text for reason in against), maps=dict.fromkeys(equations), verdicts={},
        hypotheses=likeliest(**equations), lacking_roles=dict(lacking), memory=remembers(**(memory or {})),
        settings={"same as": {"x": same or {}}, "catalogue": catalogue}, train=TRAIN, test=TRAIN,
        quantities=pd.DataFrame(),
    )  # fmt: skip
    if rest is not None:
        study.settings["rest beside the answer"] = {"x": rest}
    if reverse is not None:
        study.effects["reverse"] = reverse
    if law is not None:
        index = pd.MultiIndex.from_tuples([("x", "v")], names=["equation", "quantity"])
        study.__dict__["quantities"] = pd.DataFrame({"probability": [law]}, index=index)
        study.effects["quantity"] = "v"
    return study


def said(verdict, *given, **changes):
    """The sentence, with spaces that break."""
    return sentence(made(verdict, *given, **changes)).replace("\u00a0", " ")


def first(verdict, *given, **changes):
    """The headline."""
    return headline(made(verdict, *given, **changes)).replace("\u00a0", " ")


def test_no_gap_says_that_nothing_is_missing():
    assert said("no gap").startswith("Nothing is missing")


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        ("no gap", "nothing is missing (probability {}): simulation and"),
        ("instrument", "no effect is missing, it is the measurement (probability {}): a is late."),
        (
            "recalibrate",
            "no effect is missing; a coefficient of the simulation is off (probability {}; y in d(x)/dt should",
        ),
        ("unknown", "something is missing that the catalogue does not have (probability {}); the maps show"),
    ],
)
def test_a_verdict_without_an_effect_is_said_as_surely_as_it_is_known(verdict, words, monkeypatch):
    def text(p):
        monkeypatch.setitem(globals(), "likeliest", lambda **rows: likely(**rows).assign(probability=p))
        return said(verdict, measured=["a is late"], y=(1.0, 0.97, 0.25))

    likely = likeliest
    assert text(0.6).startswith("Most likely " + words.format("0.600"))
    assert text(0.4).startswith("Perhaps " + words.format("0.400"))
    assert "(probability" not in text(0.95)


def test_a_sensor_that_was_put_right_beforehand_is_as_sure_as_that_nothing_is_missing_then(monkeypatch):
    rows = {("x", "no gap"): 0.97, ("x", "instrument"): 0.02}
    index = pd.MultiIndex.from_tuples(list(rows), names=["equation", "hypothesis"])
    monkeypatch.setitem(globals(), "likeliest", lambda **_: pd.DataFrame({"probability": list(rows.values())}, index))
    assert said("instrument", measured=["a is late"]) == "No effect is missing, it is the measurement: a is late."


def test_the_unknown_says_that_the_catalogue_does_not_have_it():
    text = said("unknown")
    assert "the catalogue does not have" in text and "maps" in text


def test_what_remembers_is_said_to_with_its_probability_where_that_is_likely():
    known = {"x": {"hysteresis of x": 0.98, "relaxation of u": 0.02}}
    text = said("unknown", memory=known)
    assert "it remembers (hysteresis of x, probability 0.980)" in text and "relaxation" not in text
    beside = said("partly named", [("Cubic spring", 0.7, ())], memory=known)
    assert "cubic spring" in beside and "something else that remembers (hysteresis of x" in beside
    assert "remembers" not in said("unknown", memory={"x": {"hysteresis of x": 0.4}})


def test_what_drifts_changes_with_time():
    text = said("unknown", memory={"x": {"drift of x": 0.9}})
    assert "it changes with time (drift of x, probability 0.900)" in text and "remembers" not in text


def test_of_two_equations_that_which_remembers_is_said():
    known = {"x": {"hysteresis of x": 0.98}, "u": {"hysteresis of x": 0.1}}
    text = said("unknown", equations={"x": "unknown", "u": "no gap"}, memory=known)
    assert "in d(x)/dt that the catalogue does not have; it remembers (hysteresis of x" in text and "d(u)" not in text
    both = said("unknown", equations={"x": "unknown", "u": "unknown"}, memory=known)
    assert "the maps show its shape, and it remembers (hysteresis of x, probability 0.980) in d(x)/dt" in both
    # What remembers in an equation is not said of another.
    other = said("unknown", equations={"x": "no gap", "u": "unknown"}, memory=known)
    assert "in d(u)/dt that the catalogue does not have; the maps show its shape" in other


def test_a_named_effect_is_said_with_its_equation_and_probability():
    assert "cubic spring in d(x)/dt (probability 0.870)" in said("named", [("Cubic spring", 0.87, ())])


def test_an_output_is_called_by_its_name():
    found = said("named", [("Drag", 0.97, ())], where="R", equations={"R": "drag"})
    assert found.startswith("The simulation lacks drag in R (probability 0.970); adding it closes")
    left = said("unknown", gap=gap_table(test=(0.0, 0.1)), added=[("Drag", 0.97, ())], equations={"R": "unknown"})
    assert "leaves 10.0 % of R on held-out data unexplained" in left


def test_only_what_was_added_is_said():
    assert "diode" not in said("named", [("Cubic spring", 0.87, ())])


def test_what_an_effect_closes_is_said():
    text = said("named", [("Cubic spring", 0.87, ())])
    assert text.endswith("adding it closes 75.0 % of the gap on held-out data.")


def test_several_effects_are_all_said():
    text = said("named", [("Cubic spring", 0.87, ()), ("Drag", 0.62, ())])
    assert "cubic spring in d(x)/dt (probability 0.870) and drag in d(x)/dt (probability 0.620)" in text
    assert "adding them closes" in text


@pytest.mark.parametrize(
    ("p", "words"),
    [(1.0, "> 0.999"), (0.9995, "> 0.999"), (0.998, "0.998"), (0.4, "0.400"), (0.0001, "< 0.001")],
)
def test_a_probability_is_never_rounded_to_certainty(p, words):
    assert f"(probability {words})" in said("named", [("Cubic spring", p, ())])


def test_effects_that_cannot_be_told_apart_are_listed_with_those_that_have_no_row():
    text = said("one of", [("Cubic spring", 0.6, ("pendulum", "dead-zone")), ("Dead zone", 0.3, (), "one of")])
    assert "which effect is open: cubic spring 0.600, dead zone 0.300, pendulum. Adding cubic spring closes" in text


def test_one_of_says_the_columns_where_they_alone_are_open(monkeypatch):
    rows = effects(("Cube", 0.6, ("cube(r=u)",)), ("Cube", 0.39, (), "one of")).assign(quantity=["x", "u", "x"])
    monkeypatch.setitem(globals(), "effects", lambda *given, **kw: rows)
    text = said("one of")
    assert "which effect is open: cube of x 0.600, cube of u 0.390. Adding cube of x closes" in text


OPEN = [("Smooth friction", 0.51, ("quadratic-drag",)), ("Quadratic drag", 0.30, (), "one of")]


def test_a_law_that_is_sure_is_the_finding_and_its_names_are_open():
    assert first("one of", OPEN, law=0.9997) == (
        "A law of v is missing in d(x)/dt (probability > 0.999); which one is open: smooth friction 0.510, quadratic "
        "drag 0.300."
    )
    # A law that is not sure is none; nor is one where a sensor may be at fault instead.
    assert first("one of", OPEN, law=0.6).startswith("Something is missing in d(x)/dt (probability > 0.999); which")
    fault = [("Smooth friction", 0.51, ("offset of v",)), ("Quadratic drag", 0.30, (), "one of")]
    assert "law" not in first("one of", fault, law=0.9997)


def test_one_of_never_has_one_item(monkeypatch):
    index = pd.MultiIndex.from_tuples(
        [("x", "cubic-spring"), ("x", "cubic-spring + drag"), ("x", "unknown"), ("x", "no gap"), ("x", "diode")],
        names=["equation", "hypothesis"],
    )
    table = pd.DataFrame({"probability": [0.45, 0.1, 0.25, 0.19, 0.01]}, index=index)
    monkeypatch.setitem(globals(), "likeliest", lambda **_: table)
    text = first("one of", [("Cubic spring", 0.55, ())])
    assert text == (
        "Most likely something is missing in d(x)/dt (probability 0.810); which effect is open: cubic spring 0.550, "
        "one without a name 0.250, none 0.190."
    )
    monkeypatch.setitem(globals(), "likeliest", lambda **_: table.iloc[:1])
    assert first("one of", [("Cubic spring", 0.85, ())]) == (
        "The simulation lacks cubic spring in d(x)/dt (probability 0.850), but that is not sure."
    )


def test_effects_that_are_found_together_are_no_alternatives():
    two = [("Cubic spring", 0.8, ()), ("Pendulum", 0.7, ("sine",))]
    assert first("one of", two) == (
        "The simulation lacks cubic spring in d(x)/dt (probability 0.800) and pendulum in d(x)/dt (probability 0.700, "
        "not to be told from sine), but that is not sure."
    )
    parts = [("Coulomb friction", 0.8, ()), ("Viscous damping", 0.6, ())]
    assert first("one of", parts, law=0.995).endswith(
        "(probability 0.995); its parts are open: Coulomb friction 0.800, viscous damping 0.600."
    )


def test_one_of_whose_record_disagrees_says_so(monkeypatch):
    rows = effects(("Cubic spring", 0.98, ())).assign(agreement=0.62)
    monkeypatch.setitem(globals(), "effects", lambda *given, **kw: rows)
    assert first("one of") == (
        "The simulation lacks cubic spring in d(x)/dt (probability 0.980), but parts of the record disagree "
        "(agreement 0.620)."
    )


@pytest.mark.parametrize("verdict", ["partly named", "unknown"])
def test_what_is_rather_not_there_is_not_said_to_be_lacking(verdict):
    text = said(verdict, [("Drag", 0.30, ())])
    assert "may lack drag in d(x)/dt (probability 0.300)" in text and "lacks drag" not in text
    both = said("unknown", [("Drag", 0.30, ()), ("Cubic spring", 0.8, ())])
    assert "The simulation lacks cubic spring in d(x)/dt (probability 0.800), and may lack drag" in both


def test_a_name_that_is_likelier_than_none_stands_before_it(monkeypatch):
    index = pd.MultiIndex.from_tuples([("x", "cubic"), ("x", "unknown"), ("x", "no gap")])
    table = pd.DataFrame({"probability": [0.45, 0.35, 0.005]}, index=index.set_names(["equation", "hypothesis"]))
    monkeypatch.setitem(globals(), "likeliest", lambda **_: table)
    assert first("unknown").startswith(
        "Something is missing in d(x)/dt (probability 0.995); which effect is open: cubic 0.450, one without a name "
        "0.350; the maps"
    )


def test_what_the_headline_finds_is_not_mixed_with_what_denies_it():
    headlines = first("partly named", [("Cubic spring", 0.97, ())], gap_table((0.2, 0.5, 0.1), test=(0.4, 0.1)))
    assert "free run" not in headlines and headlines.count(" but ") <= 1
    for measured in (["a is 9 ms late"], []):
        assert "late" not in first("named", [("Cubic spring", 0.97, ())], measured=measured)


def test_the_rounding_of_the_file_is_no_remark_on_a_sensor():
    def text(sd):
        noisy = {"suspect": "noisy state", "channel": "x", "mean": sd, "status": IN_MODEL, "text": "samples have noise"}
        return said("named", [("Drag", 0.97, ())], table=pd.DataFrame([noisy]))

    # The samples of x are whole numbers.
    assert "noise" not in text(0.29) and text(0.6).endswith("Of the measurement: samples have noise.")


def noisy_gap(before, after, noise, metric="derivative NMSE"):
    """A gap with the mean square error beside it, whose unit is another one: twice the variance."""
    gap = gap_table(test=(before, after))
    gap.loc[("test", metric, "x"), :] = (2 * before + noise, 2 * after + noise, 2 * after + noise)
    return gap


def test_nothing_is_closed_where_the_misfit_was_within_the_noise_before():
    # The mean square of three rows of noise 0.4 is known to 0.4 (2/3)^½ = 0.33: up to 0.65 in excess is no gap.
    assert "closes no gap on held-out data, which show none" in said(
        "named", [("Drag", 0.97, ())], noisy_gap(0.32, 0.08, 0.4)
    )
    assert "closes 75.0 % of the gap" in said("named", [("Drag", 0.97, ())], noisy_gap(0.36, 0.09, 0.4))
    gap = gap_table(test=(0.4, 0.1))
    for misfit, words in ((0.98, "closes no gap"), (1.2, "closes 75.0 %")):
        gap.loc[("test", "misfit of samples", "x"), :] = misfit
        assert words in said("named", [("Drag", 0.97, ())], gap)
    # What grows is said to.
    assert "widens the gap" in said("named", [("Drag", 0.97, ())], noisy_gap(0.1, 0.3, 0.4))


def test_what_has_a_name_closes_what_it_closes_without_f():
    alone = CLOSED.rename(index={"unexplained share": NAMES_ALONE}, level="metric").assign(after=0.2)
    text = said("partly named", [("Cubic spring", 0.87, ())], gap=pd.concat([CLOSED, alone]))
    assert text.endswith("adding what has a name closes 50.0 % of the gap on held-out data.")


def test_partly_named_says_that_something_else_is_missing_too():
    text = said("partly named", [("Cubic spring", 0.87, ())])
    assert "cubic spring" in text and "something else that the catalogue does not have" in text
    assert text.endswith("adding what has a name closes 75.0 % of the gap on held-out data.")


@pytest.mark.parametrize(
    ("p", "words"),
    [
        (0.7, "and something else that the catalogue does not have; adding"),
        (0.31, "and perhaps something else that the catalogue does not have (probability 0.310); adding"),
    ],
)
def test_what_may_be_missing_besides_is_said_as_surely_as_it_is_known(p, words):
    assert words in said("partly named", [("Cubic spring", 0.87, ())], rest=p)


def test_an_effect_of_the_other_sign_is_said_to_do_the_reverse():
    text = said("named", [("Drag", 0.97, ())], reverse="feeds energy in: pushes along")
    assert "drag in d(x)/dt (probability 0.970, sign reversed: “feeds energy in: pushes along”)" in text
    assert "sign" not in said("named", [("Drag", 0.97, ())])


def test_without_a_catalogue_none_is_said_to_lack_what_is_missing():
    text = said("unknown", catalogue=NO_CATALOGUE)
    assert "Something is missing, for which no effect was weighed; the maps show its shape." in text


def test_recalibration_says_the_right_coefficient_and_the_wrong_one():
    text = said("recalibrate", y=(1.0, 0.97, 0.25))
    assert "No effect is missing" in text
    assert "y in d(x)/dt should have 1.25, not 1" in text
    assert text.startswith("No effect is missing; a coefficient of the simulation is off (")
    assert "setting it right closes 75.0 % of the gap" in text


def test_an_error_of_a_sensor_that_does_the_same_as_a_wrong_coefficient_is_told():
    same = {
        "gain of F": {"what": "recalibration of F", "change": 0.1},
        "offset of u": {"what": "offset of x", "change": 0.1},
    }
    text = said("recalibrate", same=same, F=(1.0, 0.97, -0.2))
    assert "F in d(x)/dt should have 0.8, not 1, or else it is the gain of F, which does the same)" in text
    assert "or else" not in said("recalibrate", same=same, F=(1.0, 0.97, -0.4))
    assert "offset" not in text and "or else" not in said("recalibrate", same=same, y=(1.0, 0.97, 0.25))


def test_coefficients_that_are_all_off_by_one_factor_are_told_as_that():
    same = {"gain of F": {"what": "recalibration of F", "change": 0.1}}
    off = {"F": (2.0, 0.99, -0.2), "y": (-4.0, 0.99, 0.41)}
    text = said("recalibrate", same=same, **off)
    factor = "all in d(x)/dt should be 0.8987 times what they are, as where a mass, an inertia or a capacity is wrong"
    assert f"({factor}: F 1.8 and y −3.59)" in text and "which does the same" not in text
    # One that is right, or another's change, and there is no common factor.
    assert "times what" not in said("recalibrate", **off, u=(1.0, 0.01, 0.0))
    assert "times what" not in said("recalibrate", F=off["F"], y=(-4.0, 0.99, 0.6))


def test_a_gain_of_the_rate_that_may_stand_in_the_place_of_a_common_factor_is_told():
    def table(p):
        rate = {"equation": "x", "suspect": "gain", "channel": "d(x)/dt", "text": "d(x)/dt reads 10% too small"}
        return pd.DataFrame([{**rate, "probability": p, "status": ""}])

    off = {"F": (2.0, 0.99, -0.2), "y": (-4.0, 0.99, 0.4)}
    assert "wrong, or else d(x)/dt reads 10% too small, which does the same: F" in said(
        "recalibrate", table=table(0.2), **off
    )
    assert "or else" not in said("recalibrate", table=table(0.01), **off)


def test_recalibration_passes_over_coefficients_that_are_rather_right():
    text = said("recalibrate", y=(1.0, 0.97, 0.25), u=(2.0, 0.49, 0.1))
    assert "y in d(x)/dt" in text and "u in d(x)/dt" not in text


def test_recalibration_lists_all_coefficients_that_are_rather_wrong():
    text = said("recalibrate", y=(1.0, 0.97, 0.25), u=(2.0, 0.51, 0.1))
    assert "coefficients of the simulation are off (" in text and "setting them right closes" in text
    assert "should have 1.25, not 1; u in d(x)/dt should have 2.1, not 2" in text


def test_recalibration_admits_that_it_does_not_know_the_coefficient():
    assert "which one the data cannot say" in said("recalibrate", y=(1.0, 0.49, 0.25), u=(2.0, 0.49, 0.1))


def test_recalibration_passes_over_what_is_there_for_anothers_sake_and_comes_to_nothing():
    text = said("recalibrate", y=(1.0, 0.97, 0.25), u=(2.0, 0.97, 0.01))
    assert "y in d(x)/dt" in text and "u in d(x)/dt" not in text


def test_a_gap_that_grows_is_said_to_widen():
    text = said("named", [("Cubic spring", 0.87, ())], gap_table(test=(0.2, 0.3)))
    assert text.endswith("adding it widens the gap on held-out data by 50.0 %.")


def test_a_gap_that_is_closed_all_but_wholly_is_not_rounded_to_wholly():
    text = said("named", [("Cubic spring", 0.87, ())], gap_table(test=(1.0, 0.0001)))
    assert "closes > 99.9 % of the gap" in text


def test_a_gap_that_hardly_changes_is_left_as_it_is():
    def text(before, after, run=(9.0, 0.1, 0.1)):
        return said("named", [("Cubic spring", 0.87, ())], gap_table(run, test=(before, after)))

    for after in (0.49998, 0.50002):
        assert text(0.5, after).endswith("adding it leaves the gap on held-out data as it is.")
    assert "leaves what is unexplained of the rate on held-out data as it is, and the free run of x gets" in text(
        0.5, 0.49998, (0.2, 0.5, 0.1)
    )
    # Ends that do not show are no gap, and no multiple of one.
    assert text(1e-7, 1e-5).endswith("adding it closes no gap on held-out data, which show none.")
    # Precise data may show, and close, a gap of half a per cent of the rate.
    assert "adding it closes 98" in text(2.5e-5, 5e-7)


def test_where_held_out_data_show_no_gap_none_is_called_closed():
    text = said("named", [("Cubic spring", 0.87, ())], gap_table(test=(0.0, 0.0)))
    assert text.endswith("adding it closes no gap on held-out data, which show none.")


def test_held_out_data_at_rest_leave_the_word_to_the_training_data():
    nan = float("nan")
    gap = gap_table((nan, nan, nan), train=(1.0, 0.25), test=(nan, nan))
    assert said("named", [("Cubic spring", 0.87, ())], gap).endswith("closes 75.0 % of the gap on the training data.")


def test_the_gap_on_held_out_data_counts_where_there_are_any():
    text = said("named", [("Cubic spring", 0.87, ())], gap_table(train=(1.0, 0.9), test=(0.4, 0.1)))
    assert "closes 75.0 % of the gap on held-out data" in text


def test_without_held_out_data_the_gap_is_that_on_the_training_data():
    text = said("named", [("Cubic spring", 0.87, ())], gap_table(train=(1.0, 0.9)))
    assert "closes 10.0 % of the gap on the training data" in text


def test_the_gaps_of_several_equations_are_added_up():
    gap = pd.concat([CLOSED, CLOSED.rename(index={"x": "z"}) * [1.0, 4.0, 4.0]])
    # 0.4 and 0.4 before, 0.1 and 0.4 after.
    assert "widens" not in said("named", [("Cubic spring", 0.87, ())], gap)
    assert "closes 37.5 % of the gap" in said("named", [("Cubic spring", 0.87, ())], gap)


def test_partly_named_with_failed_checks_says_what_failed():
    text = said("partly named", [("Cubic spring", 0.87, ())], against=[CORRELATED])
    assert "cubic spring in d(x)/dt (probability 0.870), but that is not all; adding it closes 75.0 %" in text
    assert text.endswith("Against it: residuals hang together over 0.4 s.")


def test_one_of_is_no_surer_that_something_is_missing_than_it_is(monkeypatch):
    monkeypatch.setattr("bayes_greybox.report.words.missing.probability_missing", lambda *_: 0.51)
    text = said("one of", [("Cubic spring", 0.16, ("sine",)), ("Pendulum", 0.14, (), "one of")])
    assert text.startswith("Most likely something is missing in d(x)/dt (probability 0.510); which effect is open: cub")


def test_that_nothing_is_missing_is_what_the_answers_without_an_effect_say(monkeypatch):
    index = pd.MultiIndex.from_tuples(
        [("x", "no gap"), ("x", "instrument"), ("x", "unknown"), ("x", "cubic")], names=["equation", "hypothesis"]
    )
    table = pd.DataFrame({"probability": [0.4, 0.1, 0.2, 0.3]}, index=index)
    study = SimpleNamespace(hypotheses=table)
    assert probability_missing(study) == pytest.approx(0.5)


def test_what_is_sure_is_no_part_of_what_is_one_of_several():
    sure = ("Cubic spring", 0.999, ())
    text = said("one of", [sure, ("Constant force", 0.59, ("offset of y",))])
    assert text.startswith(
        "The simulation lacks cubic spring in d(x)/dt (probability 0.999), and perhaps constant force"
    )
    assert "constant force 0.590 or an error of the sensor (offset of y). Adding cubic spring and constant" in text
    text = said("one of", [sure, ("Pendulum", 0.6, ("sine",)), ("Dead zone", 0.39, (), "one of")])
    assert "0.999); something else is missing besides, and which effect is open: pendulum 0.600, dead" in text
    # Else there is nothing besides.
    assert "0.999), and perhaps pendulum 0.550." in said("one of", [sure, ("Pendulum", 0.55, ())])
    # A term that only fits what is left is no candidate.
    drag = ("Quadratic drag", 0.001, ())
    assert "0.999), and perhaps pendulum 0.550. Adding cubic" in said("one of", [sure, ("Pendulum", 0.55, ()), drag])
    assert "0.999); what is added besides has no name" in said("one of", [sure, drag])


def test_the_instrument_is_said_alone_or_beside_what_is_missing():
    assert said("instrument", measured=["a is 9 ms late"]) == (
        "No effect is missing, it is the measurement: a is 9 ms late."
    )
    text = said("named", [("Cubic spring", 0.97, ())], measured=["a is 9 ms late", "its noise grows with |y|"])
    assert text.endswith("Of the measurement: a is 9 ms late; its noise grows with |y|.")
    assert "u is 9 s late" not in text
    assert "of it the data cannot say" in said("instrument")


@pytest.mark.parametrize(("after", "how"), [(0.5, "gets worse"), (0.2, "does not get better")])
def test_no_gap_is_called_closed_that_the_free_run_denies(after, how):
    text = said("partly named", [("Cubic spring", 0.97, ())], gap_table((0.2, after, 0.1), test=(0.4, 0.1)))
    assert "closes" not in text
    assert f"lowers what is unexplained of the rate on held-out data by 75.0 %, but the free run of x {how}" in text


@pytest.mark.parametrize(
    ("after", "how"), [(0.6, "by 50.0 %"), (0.8, "to 2 times what it was"), (4e3, "to 10000 times what it was")]
)
def test_what_rises_is_said_with_its_size_and_without_a_but(after, how):
    text = said("partly named", [("Cubic spring", 0.97, ())], gap_table((0.2, 0.5, 0.1), test=(0.4, after)))
    assert f"raises what is unexplained of the rate on held-out data {how}, and the free run of x gets worse" in text
    assert f"widens the gap on held-out data {how}." in said("named", [("Drag", 0.9, ())], gap_table(test=(0.4, after)))


def test_of_two_equations_what_has_a_name_is_said_beside_what_has_none():
    text = said("unknown", [("Drag", 0.97, ())], where="z", equations={"x": "unknown", "z": "drag"})
    assert text == (
        "Something is missing in d(x)/dt that the catalogue does not have; the maps show its shape. The simulation "
        "lacks drag in d(z)/dt (probability 0.970) too; adding it closes 75.0 % of the gap on held-out data."
    )
    text = said("unknown", equations={"x": "unknown", "z": "no gap"})
    assert text == "Something is missing in d(x)/dt that the catalogue does not have; the maps show its shape."


@pytest.mark.parametrize("verdict", ["named", "one of", "partly named"])
def test_of_two_equations_a_coefficient_that_is_off_is_said_beside_an_effect(verdict):
    two = {"x": "recalibrate", "z": "drag"}
    text = said(verdict, [("Drag", 0.97, ())], where="z", equations=two, y=(1.0, 0.97, 0.25), u=(2.0, 0.8, 0.1))
    assert "drag in d(z)/dt" in text
    assert text.endswith(
        "Coefficients of the simulation are off besides: y in d(x)/dt should have 1.25, not 1; u in d(x)/dt should "
        "have 2.1, not 2 (probability 0.800)."
    )
    # Beside something unknown, too.
    text = said("unknown", equations={"x": "unknown", "z": "no gap"}, y=(1.0, 0.97, 0.25))
    assert text.endswith("A coefficient of the simulation is off besides: y in d(x)/dt should have 1.25, not 1.")
