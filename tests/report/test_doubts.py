"""What speaks against a verdict: one list for page, terminal and record, from the tables that the sentence is from."""

import io
import json
from dataclasses import replace
from html import unescape

import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from tiny_study import DELAYED, judged, varied

from bayes_greybox.data.rates.rate_filter import RateFilter
from bayes_greybox.report.folders.study_record import study_record
from bayes_greybox.report.pages.page import render
from bayes_greybox.report.pages.study_page import study_page
from bayes_greybox.report.terminal.study import study_tables
from bayes_greybox.report.words.doubts import doubts, p_text
from bayes_greybox.report.words.formatting import percent_text, probability_text
from bayes_greybox.report.words.sentence import sentence, statements
from bayes_greybox.report.words.study import suspect_size, suspects_weighed

PLAIN = {"maps": {}, "traces": {}, "paths": {}}


def spaced(text: str) -> str:
    """One line, with spaces that break."""
    return " ".join(text.replace("\u00a0", " ").split())


def by_topic(study, topic: str) -> list:
    return [each for each in doubts(study) if each.topic == topic]


def worse(study):
    """The study with a free run of y that gets worse, and the veto that this brings."""
    gap = study.gap.copy()
    gap.loc[("test", "free-run NRMSE", "y"), ["before", "after", "lower", "upper"]] = (0.1, 0.3, 0.2, 0.4)
    return replace(study, gap=gap, verdict="partly named", against=("the free run of y gets worse",))


def test_nothing_speaks_against_a_study_that_passed_all_its_checks(study):
    found = doubts(study)
    assert [each.topic for each in found] == [
        "Residuals", "Residuals", "What remains", "Runner-up", "Measurement", "Ties", "Free run", "Sampler",
    ]  # fmt: skip
    assert not any(each.against for each in found) and not study.against
    white, shape = found[:2]
    assert white.text == f"Residuals are white ({p_text(study.checks.loc[('ydot', 'whiteness'), 'p'])})"
    assert p_text(study.checks.loc[("ydot", "LOO-PIT"), "p"]) in shape.text


def test_a_failed_check_is_said_in_its_own_words_with_its_p_value(study):
    failed = varied(study, checks={"whiteness": (1e-9, "residuals hang together over 0.4 s")})
    first = doubts(failed)[0]
    assert first.against and spaced(first.text) == "Residuals hang together over 0.4 s (whiteness, p < 0.001)"
    assert failed.against == ("residuals hang together over 0.4 s",) and failed.verdict == "partly named"


def test_what_of_the_record_is_missing_is_said_wherever_the_verdict_is(study):
    gap = 'run "0" has no rows from 17 to 19: it begins anew after them'
    with_gap = replace(study, train=study.train.remarked(gap), test=study.test.remarked(gap, "every 2nd row"))
    assert terminal(with_gap).count(gap) == 1 and "every 2nd row" in terminal(with_gap)
    assert unescape(render(study_page(with_gap))).count(gap) == 1
    assert study_record(with_gap, {})["data"]["remarks"] == [gap, "every 2nd row"]


@pytest.mark.parametrize(("n", "words"), [(40, "a rest beside what has a name"), (39, "too few")])
def test_what_was_not_tested_is_not_called_passed(study, n, words):
    # Of the rows those count that a study weighs; of a study that was saved before these were kept, all do.
    assert study.counted == {"ydot": study.train.n_obs}
    train = study.train.keep(np.arange(study.train.n_obs) < n)
    for few in (replace(study, counted={"ydot": n}), replace(study, counted={}, train=train)):
        (only,) = by_topic(replace(few, checks=study.checks.iloc[:0]), "Residuals")
        assert only.against is None and words in only.text


def test_the_veto_of_the_free_run_is_said_with_its_numbers(study):
    (run,) = by_topic(worse(study), "Free run")
    assert run.against and spaced(run.text) == ("The free run of y gets worse on held-out data: y 10.0 % → 30.0 %")
    gap = study.gap.copy()
    gap.loc[("test", "free-run NRMSE", "y"), ["before", "after", "lower", "upper"]] = (0.1, 0.101, 0.05, 0.4)
    (run,) = by_topic(replace(study, gap=gap), "Free run")
    assert run.against and run.text.startswith("The free run of y does not get better")
    gap.loc[("test", "time to failure", "all"), ["before", "after"]] = (np.inf, 3.0)
    (run,) = by_topic(replace(study, gap=gap), "Free run")
    said = "The free run fails sooner: the extended model's after 3 s, the simulation's never, on held-out data"
    assert run.against and spaced(run.text) == said
    none = study.gap[study.gap.index.get_level_values("metric") != "free-run NRMSE"]
    assert by_topic(replace(study, gap=none), "Free run")[0].against is None


def failing(study, before, after, upper, **parts):
    """The study with free runs that blow up at these times."""
    gap = study.gap.copy()
    gap.loc[("test", "time to failure", "all"), ["before", "after", "lower", "upper"]] = (before, after, after, upper)
    for name, row in parts.items():
        gap.loc[("test", "free-run NRMSE", name), ["before", "after", "lower", "upper"]] = row
    return replace(study, gap=gap)


def test_never_is_later_than_any_time_to_failure(study):
    # NaN is never: the table has no infinities.
    (run,) = by_topic(failing(study, np.nan, 3.0, 4.0), "Free run")
    assert run.against and "the extended model's after 3 s, the simulation's never" in spaced(run.text)
    (run,) = by_topic(failing(study, 3.0, np.nan, np.nan), "Free run")
    assert not run.against and "fails" not in run.text


def test_the_page_and_the_veto_agree_on_when_a_run_fails_sooner(study):
    # Within two per cent, and where the interval reaches beyond the time before, it does not fail sooner.
    for after, upper in ((2.97, 2.99), (2.0, 5.0)):
        assert not by_topic(failing(study, 3.0, after, upper), "Free run")[0].against
    both = failing(study, 3.0, 1.0, 1.5, y=(0.1, 0.3, 0.2, 0.4))
    (run,) = by_topic(both, "Free run")
    assert "free run of y gets worse" in run.text and "the free run fails sooner" in run.text


def test_another_explanation_speaks_against_the_answer_where_it_is_likely(study):
    table = study.hypotheses.copy()
    table["probability"] = 0.0
    table.loc[("ydot", "cubic-stiffness"), ["probability", "share_left"]] = (0.55, 0.02)
    table.loc[("ydot", "unknown"), "probability"] = 0.25
    table.loc[("ydot", "no gap"), "probability"] = 0.2
    changed = replace(study, hypotheses=table)
    (remains,), (second,) = by_topic(changed, "What remains"), by_topic(changed, "Runner-up")
    assert remains.against and "missing is 0.250" in remains.text and "2.0 % of the gap" in spaced(remains.text)
    # A set is compared with a set, and what remains is no rival of one set.
    assert second.against and second.text == "No gap, 0.200; the answer's set by itself, 0.550"
    table.loc[("ydot", "power-law-stiffness"), "probability"] = 0.6
    second = by_topic(replace(study, hypotheses=table), "Runner-up")[0]
    assert second.text.startswith("Power-law stiffness by itself, 0.600; the answer's set by itself, 0.550; effect by")
    table.loc[("ydot", "power-law-stiffness"), "probability"] = 0.0
    # Against any effect stands that none is missing.
    nothing = {"verdict": "no gap", "effects": study.effects.assign(status="")}
    table.loc[("ydot", "recalibrate"), "probability"] = 0.15
    second = by_topic(replace(study, hypotheses=table, **nothing), "Runner-up")[0]
    assert second.text == "Cubic stiffness with probability 0.550; that no effect is missing has 0.350"
    table.loc[("ydot", "recalibrate"), "probability"] = 0.0
    # What is likelier than the answer, and yet is not it, is said with the reason.
    empty = {"verdict": "unknown", "effects": study.effects.assign(status="")}
    second = by_topic(replace(changed, **empty), "Runner-up")[0]
    assert second.text.startswith("Cubic stiffness with probability 0.550, the answer 0.250; but it leaves 2.0")


def test_what_speaks_against_unknown_is_what_has_a_name(study):
    table = study.hypotheses.copy()
    table["probability"] = 0.0
    table.loc[("ydot", "unknown"), "probability"] = 0.75
    table.loc[("ydot", "cubic-stiffness"), "probability"] = 0.25
    unknown = replace(study, verdict="unknown", effects=study.effects.assign(status=""), hypotheses=table)
    (others,) = by_topic(unknown, "Other explanations")
    assert others.text.endswith("; what is missing is a law of y (probability >\xa00.999)")
    unknown = replace(unknown, quantities=study.quantities.iloc[:0])
    (others,) = by_topic(unknown, "Other explanations")
    assert others.text == "What has a name, or needs none, has probability 0.250 in all" and others.against is False
    assert not by_topic(unknown, "What remains") and not by_topic(study, "Other explanations")
    table.loc[("ydot", ["unknown", "cubic-stiffness"]), "probability"] = 0.4, 0.6
    (others,) = by_topic(unknown, "Other explanations")
    assert others.against is True


def test_effects_that_were_not_weighed_for_want_of_a_role_are_said(study):
    changed = replace(study, lacking_roles={("ydot", "sine"): "position", ("ydot", "gravity"): "other_position"})
    (only,) = by_topic(changed, "Not weighed")
    assert only.against is None
    said = (
        "1 effect was not weighed: no column plays the role 'position'; give roles={'position': \"COLUMN\"}, in a file "
        'position = "COLUMN" under [study.roles]'
    )
    assert only.text == said and by_topic(study, "Not weighed") == []


def test_ties_the_sampler_and_likely_suspects_speak_against(study):
    tied = [{"equation": "ydot", "slugs": ("cubic-stiffness", "quintic-stiffness"), "advice": "measure further"}]
    instrument = pd.DataFrame([{**DELAYED, "probability": 0.3, "status": ""}])
    changed = replace(study, ties=tied, instrument=instrument, fit=judged(study.fit, False))
    assert by_topic(changed, "Ties")[0].text == "These data do not tell cubic stiffness from quintic stiffness"
    assert (
        "possible: d(ydot)/dt is 0.1 s late (0.5 samples) (probability 0.300)"
        in by_topic(changed, "Measurement")[0].text
    )
    assert "did not converge: R̂ is 1.04" in by_topic(changed, "Sampler")[0].text
    assert all(by_topic(changed, topic)[0].against for topic in ("Ties", "Measurement", "Sampler"))
    assert by_topic(replace(study, fit=None), "Sampler")[0].against is None


def test_a_delay_of_many_samples_is_hardly_one(study):
    far = varied(study, instrument={"mean": 2.0, "samples": 10.0, "text": "d(ydot)/dt is 2 s late (10 samples)"})
    (only,) = by_topic(far, "Measurement")
    assert only.against and only.text == "More than 6 samples are hardly a delay: d(ydot)/dt is 2 s late (10 samples)"


def test_the_record_is_json_and_has_what_speaks_against_the_verdict(study):
    changed = worse(varied(study, instrument={"upper_samples": np.nan}))
    record = json.loads(json.dumps(study_record(changed, {}), allow_nan=False))
    assert record["against"] == ["the free run of y gets worse"]
    assert [row["check"] for row in record["checks"]] == ["whiteness", "LOO-PIT"] and record["checks"][0]["ok"] is True
    assert record["instrument"][0]["status"] == "in the model" and record["instrument"][0]["upper_samples"] is None
    assert [(each["topic"], each["against"]) for each in record["doubts"]] == [
        (each.topic, each.against) for each in doubts(changed)
    ]


def terminal(study) -> str:
    console = Console(width=300, record=True, file=io.StringIO())
    for part in study_tables(study):
        console.print(part)
    return spaced(console.export_text())


@pytest.mark.parametrize("kind", ["named", "late", "checks", "free run", "one of", "instrument"])
def test_sentence_tables_page_terminal_and_record_say_the_same(study, kind):
    tied = ("quintic-stiffness",)
    effects = study.effects.assign(
        status=["added", *("one of" if slug in tied else "" for slug in study.effects["slug"][1:])],
        tied_with=[tied, *study.effects["tied_with"][1:]],
    )
    sure = study.hypotheses.assign(probability=0.0)
    sure.loc[("ydot", "instrument"), "probability"] = 0.98
    one = {
        "named": study,
        "late": varied(study, instrument={}),
        "checks": varied(study, checks={"LOO-PIT": (1e-4, "the noise has heavier tails than the model's")}),
        "free run": worse(study),
        "one of": replace(study, verdict="one of", effects=effects),
        "instrument": replace(
            varied(study, verdict="instrument", effects=study.effects.assign(status=""), instrument={}), hypotheses=sure
        ),
    }[kind]
    said, (first, *others) = spaced(sentence(one)), map(spaced, statements(one))
    page = spaced(unescape(render(study_page(replace(one, **PLAIN)))))
    shown, record = terminal(one), study_record(one, {})
    assert f">{first}</h1>" in page and " ".join(others) in page
    assert said in shown and said == spaced(record["sentence"]) and record["headline"] in record["sentence"]
    for each in record["asked"]:
        assert spaced(each["text"]) in page and spaced(each["text"]) in shown
    for row in record["effects"]:
        if row["status"]:
            p = spaced(probability_text(row["probability"]))
            assert row["name"].lower() in said and p in said and p in page
    closed = record["gap"] and one.gap.loc[("test", "unexplained share", "ydot"), "closed"]
    assert (kind == "free run") == ("lower by" in page) and not (kind == "free run" and "of the gap closed" in page)
    assert ("Delays that are in the model are undone" in page) == (kind in ("late", "instrument"))
    if "closes" in said:
        assert f"closes {spaced(percent_text(min(closed, 0.9999)))}" in said
    for row in record["instrument"]:
        assert (row["text"] in said) == (row["status"] == "in the model")
        assert row["text"] in page and (row["text"] in shown or not row["status"])
    for text in record["against"]:
        assert text in said
        assert any(text.lower() in each["text"].lower() and each["against"] for each in record["doubts"])
    for each in record["doubts"]:
        assert spaced(each["text"]) in page and spaced(each["text"]) in shown
    assert ("speak against it" in page.split("<h1")[0].split("</style>")[1]) == bool(record["against"])


def test_suspects_have_a_size_in_their_unit_and_in_samples(study):
    assert suspect_size(DELAYED) == ("0.100 ± 0.010 s", "0.084 to 0.116", "0.5 (0.42 to 0.58)")
    gain = {**DELAYED, "suspect": "gain", "mean": 0.02, "sd": 0.005, "lower": 0.012, "upper": 0.028}
    assert [spaced(text) for text in suspect_size(gain)] == ["2.0 % ± 0.50 %", "1.2 % to 2.8 %", "–"]
    noise = {**DELAYED, "suspect": "heavy tails", "mean": 3.0, "sd": np.nan, "unit": "", "samples": np.nan}
    assert suspect_size(noise) == ("–", "–", "–")
    twin = {"ydot": {"delay of y": {"what": "recalibration of ydot", "change": 0.1}}}
    weighed = dict(suspects_weighed(replace(study, settings={**study.settings, "same as": twin})))
    # The y of a linear spring that comes late is damping.
    assert spaced(weighed["Delay of d(ydot)/dt, all states together, ydot, F"]) == "0.020 each; size ± 2 samples"
    assert weighed["Delay of y"] == "as recalibration of ydot, which does the same"
    assert suspects_weighed(replace(study, settings={})) == []
    # A rate that was computed from y has no sensor of its own.
    computed = RateFilter("savgol", 11, 3, None, 0.05, (("y", "ydot"),), (("y", 1), ("ydot", 2)), (0.1,))
    behind = replace(study, train=replace(study.train, filter=computed), settings={**study.settings, "same as": {}})
    assert [key for key, _ in suspects_weighed(behind)][:3] == [
        "Delay of all states together, F", "Gain of y, F", "Offset of y, F"
    ]  # fmt: skip


def test_a_free_run_that_nothing_changed_is_not_said_to_be_the_work_of_f(study):
    gap = study.gap.copy()
    runs = gap.index.get_level_values("metric") == "free-run NRMSE"
    # Nothing but what the integrator makes of it.
    gap.loc[runs, ["before", "after"]] = (3e-6, 2e-6)
    idle = {"gap": gap, "effects": study.effects.assign(status="")}
    for verdict in ("no gap", "instrument", "unknown"):
        (run,) = by_topic(replace(study, verdict=verdict, **idle), "Free run")
        assert run.against is False and run.text.startswith("Nothing was added, so it stays as it is")
    gap.loc[runs, ["before", "after"]] = (0.3, 0.2)
    (run,) = by_topic(replace(study, verdict="instrument", **idle), "Free run")
    assert "what was found of the sensors does this" in run.text
    (run,) = by_topic(replace(study, verdict="unknown", **idle), "Free run")
    assert "f of any shape does this" in run.text


def test_a_sampler_that_disagrees_with_the_tables_is_said_to(study):
    assert "disagrees" not in by_topic(study, "Sampler")[0].text
    effects = study.effects.copy()
    off = (effects["status"] != "").to_numpy()
    effects.loc[off, "mean"] = effects.loc[off, "mean"] + 100 * effects.loc[off, "sd"]
    (sampler,) = by_topic(replace(study, effects=effects), "Sampler")
    assert sampler.against and "fit disagrees with the tables: its coefficient of cubic stiffness is" in sampler.text
