"""Data that break an assumption: that they do, and by how much they say they do."""

import hashlib
import json
from collections import Counter
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from bayes_greybox.running.errors import InputError
from benchmarks.hidden_effects.assumptions.case import AssumptionCase
from benchmarks.hidden_effects.assumptions.cases import assumption_cases
from benchmarks.hidden_effects.assumptions.families import FAMILIES, for_a_moment, sensors
from benchmarks.hidden_effects.assumptions.families.noises import OUTLIERS, autoregressive
from benchmarks.hidden_effects.assumptions.generate import generate
from benchmarks.hidden_effects.assumptions.hosts import EFFECTS, PLACES, placed
from benchmarks.hidden_effects.assumptions.score import assumption_scores, claim_denied
from benchmarks.hidden_effects.cases import all_cases, subset
from benchmarks.hidden_effects.run import HIDDEN_EFFECTS, Ways, show, to_solve
from benchmarks.hidden_effects.scoring import case_scores
from benchmarks.hidden_effects.scoring.score import score
from benchmarks.hidden_effects.solvers import peers
from benchmarks.hidden_effects.solvers.study import record
from benchmarks.hidden_effects.systems.hidden import CATALOGUE, find
from benchmarks.runner import Asked, perform

CASES = assumption_cases()


@cache
def made(case):
    return generate(case)


def one(family, breach=None, size=None, hides=False, host=None, **more):
    """The first case like that."""
    return next(
        case
        for case in CASES
        if case.family == family
        and breach in (None, case.breach)
        and size in (None, case.size)
        and bool(case.effects) == hides
        and host in (None, case.host)
        and all(getattr(case, name) == value for name, value in more.items())
    )


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def rate_noise(data):
    return data.train.derivatives[data.equation] - data.exact["train"].rates[data.equation]


def beside_what_is_hidden(data):
    """What acts in the studied equation and is in no catalogue."""
    values = data.exact["train"].values[1:]
    return data.gap() - sum(truth.coefficient * value for truth, value in zip(data.effects, values, strict=True))


# Cases


def test_cases_follow_from_the_seed_and_old_ones_stay():
    assert assumption_cases() == CASES
    assert len({case.key for case in CASES}) == len(CASES) == 412
    assert not {case.seed for case in CASES} & {case.seed for case in assumption_cases(1)}
    assert len(all_cases()) == 396 and not {case.family for case in all_cases()} & set(FAMILIES)


def test_every_family_hides_and_does_not_hide():
    counts = Counter((case.family, bool(case.effects)) for case in CASES)
    for family in FAMILIES:
        least = 6 if family == "for a moment" else 8
        assert counts[family, True] >= least
        assert counts[family, False] >= least or family == "smooth friction"
    assert sum(bool(case.effects) for case in CASES) >= 0.4 * len(CASES)


def test_hosts_can_show_what_is_hidden_in_them_and_most_signs_are_natures():
    single = [case for case in CASES if len(case.effects) == 1]
    for case in CASES:
        assert all(find(case.system.domain, slug).fits(case.system) for slug in case.effects), case.key
    for name, effects in EFFECTS.items():
        assert set(effects) <= set(CATALOGUE[PLACES[name].visible.domain])
    assert 0.65 <= np.mean([case.signs[0] < 0 for case in single]) <= 0.85


def test_more_rows_keep_the_step():
    small, large = placed("machine", 601).visible, placed("machine", 6002).visible
    assert small.times[1] == pytest.approx(large.times[1]) == pytest.approx(0.02)
    assert large.samples * large.runs == 6002


def test_a_subset_spans_both_parts():
    few = subset((*all_cases(), *CASES), 40)
    assert {case.family for case in few} >= set(FAMILIES)
    assert any(not isinstance(case, AssumptionCase) for case in few)


def test_an_unknown_host_is_refused():
    with pytest.raises(InputError, match="no host 'moon'"):
        replace(CASES[0], host="moon")


# Data


def test_the_same_case_gives_the_same_data():
    case = one("heavy tails", "jitter", hides=True)
    first, second = generate(case), generate(case)
    pd.testing.assert_frame_equal(first.train.to_frame(), second.train.to_frame())
    pd.testing.assert_frame_equal(first.test.to_frame(), second.test.to_frame())


@pytest.mark.parametrize("family", ["delay", "correlated noise", "sensor", "filtered rates", "only together"])
def test_what_is_hidden_is_in_the_data(family):
    data = made(next(case for case in CASES if case.family == family and case.effects and case.system.samples < 3000))
    exact = data.exact["train"]
    columns = {role: exact.columns[name] for role, name in data.host.roles.items()}
    gap = sum(
        truth.coefficient * find(data.host.domain, truth.slug).value(columns, truth.inner) for truth in data.effects
    )
    np.testing.assert_allclose(data.gap(), gap, atol=1e-9 * np.abs(gap).max())
    assert all(truth.ratio > 1.0 for truth in data.effects)
    # And it acts: the states solve the equation with it.
    host = data.host
    step, n = host.times[1], data.train.run_lengths[0]
    path, rate = exact.columns[host.equation][:n], exact.rates[host.equation][:n]
    slope = (path[:-4] - 8 * path[1:-3] + 8 * path[3:-1] - path[4:]) / (12 * step)
    # Friction jumps, but seldom.
    assert np.quantile(np.abs(slope - rate[2:-2]), 0.9) < 1e-3 * np.abs(rate).max()


def test_nothing_is_missing_where_nothing_is_hidden():
    for family in ("delay", "noisy states", "state-dependent noise"):
        assert np.abs(made(one(family)).gap()).max() < 1e-12


@pytest.mark.parametrize(
    ("breach", "size"), [("rate", 0.5), ("rate", 2.0), ("backward differences", 0.5), ("forward differences", -0.5)]
)
def test_a_late_rate_is_the_rate_of_before(breach, size):
    case = one("delay", breach, size)
    data = made(case)
    exact, step = data.exact["train"].rates[data.equation], data.host.times[1]
    measured, t = data.train.derivatives[data.equation], data.host.times
    errors = {
        steps: rms((measured - np.interp(t - steps * step, t, exact))[5:-5])
        for steps in (-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0)
    }
    assert min(errors, key=errors.get) == size
    assert errors[size] == pytest.approx(data.sigma, rel=0.15)
    for state in data.host.states:
        np.testing.assert_array_equal(data.train.states[state], data.exact["train"].columns[state])


@pytest.mark.parametrize(("breach", "columns"), [("states", ("y", "ydot")), ("position", ("y",)), ("input", ("F",))])
def test_late_channels_are_those_that_the_case_says(breach, columns):
    data = made(one("delay", breach, 1.0))
    exact, given = data.exact["train"].columns, data.measured()
    for name in ("y", "ydot", "F"):
        if name in columns:
            np.testing.assert_allclose(given[name][1:], exact[name][:-1], rtol=1e-5, atol=1e-5)
        else:
            np.testing.assert_array_equal(given[name], exact[name])
    assert data.suspects[0].samples == 1.0 and set(columns) <= set(data.suspects[0].channels)


@pytest.mark.parametrize("correlation", [0.5, 0.9, 0.97])
def test_correlated_noise_has_its_correlation_and_its_spread(correlation):
    noise = autoregressive(np.random.default_rng(0), correlation, 20, 4000)
    assert np.std(noise) == pytest.approx(1.0, rel=0.05)
    assert np.mean(noise[:, 1:] * noise[:, :-1]) == pytest.approx(correlation, abs=0.05)
    # Neighbouring runs share nothing, and the first value is as large as any.
    assert np.std(noise[:, 0]) == pytest.approx(1.0, rel=0.5)
    found = rate_noise(made(one("correlated noise", size=correlation)))
    assert np.corrcoef(found[1:], found[:-1])[0, 1] == pytest.approx(correlation, abs=0.1)


def test_noise_grows_with_the_column_it_is_said_to():
    data = made(one("state-dependent noise", "velocity"))
    noise, speed = np.abs(rate_noise(data)), np.abs(data.train.states["ydot"])
    slow = speed < np.quantile(speed, 0.3)
    assert rms(noise[~slow]) > 3 * rms(noise[slow])
    assert rms(noise) == pytest.approx(data.sigma, rel=0.15)


def test_noisy_states_and_heavy_tails():
    case = one("noisy states", size=0.05)
    data = made(case)
    exact = data.exact["train"].columns["y"]
    assert rms(data.train.states["y"] - exact) == pytest.approx(0.05 * np.std(exact), rel=0.1)
    assert data.sigma > case.noise * rms(data.exact["train"].rates[data.equation])
    outliers = rate_noise(made(one("heavy tails", "outliers"))) / made(one("heavy tails", "outliers")).sigma
    assert 0.002 < np.mean(np.abs(outliers) > 5) < 3 * OUTLIERS
    assert (
        np.abs(rate_noise(made(one("heavy tails", "Student t")))).max()
        > 5 * made(one("heavy tails", "Student t")).sigma
    )


def test_sensors_are_off_by_what_they_say():
    gain = made(one("sensor", "input gain"))
    np.testing.assert_allclose(gain.train.inputs["F"], 1.02 * gain.exact["train"].columns["F"])
    data = made(one("sensor", "quantised rate", 20.0))
    assert len(np.unique(data.train.derivatives[data.equation])) <= 25
    data = made(one("sensor", "clipped rate", 0.05))
    rate = data.train.derivatives[data.equation]
    assert 0.02 < np.mean(np.abs(rate) == np.abs(rate).max()) < 0.1
    assert made(one("sensor", "rate offset")).excused


def test_filtered_rates_come_from_a_displacement():
    data = made(one("filtered rates", size=0.005))
    assert data.train.states.keys() == {"y", "ydot"} and data.train.noise
    n = data.train.n_obs
    assert all(len(values) == n for values in data.exact["train"].columns.values())
    exact = data.exact["train"]
    assert rms(data.train.states["y"] - exact.columns["y"]) < 0.01 * np.std(exact.columns["y"])
    assert data.sigma < 0.3 * rms(exact.rates[data.equation])
    assert data.train.dropped == 2 * data.test.dropped or data.train.dropped % data.train.n_run == 0


@pytest.mark.parametrize("host", ["absorbed-machine", "half-seen-forced-chain"])
def test_what_is_not_measured_is_not_handed_out(host):
    case = one("memory" if host == "absorbed-machine" else "missing state", host=host)
    data = made(case)
    assert set(data.train.states) == set(data.host.states) < set(case.place.whole.states)
    assert set(data.simulation) == set(data.host.states)
    assert rms(data.gap()) > 3 * data.sigma


@pytest.mark.slow
def test_hysteresis_is_missing_and_has_no_name():
    data = made(one("memory", "Bouc-Wen strong", host="swept-oscillator"))
    assert data.effects == () and data.silent == ()
    rate = data.exact["train"].rates[data.equation]
    assert rms(data.gap()) / rms(rate) == pytest.approx(0.4, rel=0.1)


def test_smooth_friction_may_be_called_coulombs_where_it_is_sharp():
    sharp = one("smooth friction", size=0.01, hides=True)
    assert made(sharp).accepted[0] == ("smooth-friction", "coulomb-friction")
    accept = FAMILIES["smooth friction"].accepted
    assert accept(one("smooth friction", size=0.4, hides=True), "smooth-friction") == ("smooth-friction",)


def test_laws_that_the_catalogue_nearly_has_act_with_their_exponents():
    data = made(one("other laws", "drag 1.75", hides=False))
    v, gap = data.exact["train"].columns[data.case.system.roles["velocity"]], data.gap()
    # The gap is −c |v|^1.75 with the sign of v, and nothing of the catalogue's is as near.
    law = np.sign(v) * np.abs(v) ** 1.75
    size = -float(law @ gap / (law @ law))
    assert size > 0 and rms(gap + size * law) < 1e-6 * rms(gap)
    assert rms(gap) == pytest.approx(0.3 * data.sigma / data.case.noise, rel=0.05)


def test_of_two_effects_much_is_cancelled():
    data = made(one("only together", hides=True, host="biased-machine"))
    parts = [truth.coefficient * value for truth, value in zip(data.effects, data.exact["train"].values, strict=True)]
    assert rms(sum(parts)) < 0.7 * rms(parts[0])
    assert rms(data.gap()) > 2 * data.sigma


def test_families_that_came_later_follow_those_that_were_there():
    assert list(FAMILIES)[-3:] == ["bent sensors", "for a moment", "other laws"]
    assert {case.family for case in CASES[:360]} == set(list(FAMILIES)[:-3])
    seeds = "\n".join(f"{case.seed}" for case in CASES[:360])
    assert hashlib.sha1(seeds.encode(), usedforsecurity=False).hexdigest() == "6a985201323b446bb7b4e1b9bc0e44e91df8c248"


@pytest.mark.parametrize("hides", [False, True])
@pytest.mark.parametrize(("breach", "column"), [("position compresses", "y"), ("speed compresses", "ydot")])
def test_a_sensor_that_compresses_loses_its_share_at_the_largest_value_and_a_cubic_below(breach, column, hides):
    case = one("bent sensors", breach, hides=hides)
    data = made(case)
    exact, given = data.exact["train"].columns, data.measured()
    true, lost = exact[column], exact[column] - given[column]
    largest = np.argmax(np.abs(true))
    assert lost[largest] / true[largest] == pytest.approx(case.size)
    np.testing.assert_allclose(lost, lost[largest] * (true / true[largest]) ** 3, atol=1e-12)
    for name in {"y", "ydot", "F"} - {column}:
        np.testing.assert_array_equal(given[name], exact[name])
    # The sensor has the same curve on the held-out data.
    true, held_out = data.exact["test"].columns[column], data.test.states[column]
    np.testing.assert_allclose(true - held_out, lost[largest] * (true / exact[column][largest]) ** 3, atol=1e-12)


def test_compressed_positions_lose_two_to_five_percent_at_most():
    sizes = [case.size for case in CASES if case.breach == "position compresses"]
    assert min(sizes) == 0.02 and max(sizes) == 0.05


def test_a_follower_with_play_stays_until_it_is_pushed():
    shown = sensors.with_play(np.array([[0.0, 0.5, 2.0, 1.5, 0.5, -3.0], [4.0, 4.5, 6.0, 7.0, 7.5, 7.0]]), 1.0)
    assert shown.tolist() == [[0.0, 0.0, 1.0, 1.0, 1.0, -2.0], [4.0, 4.0, 5.0, 6.0, 6.5, 6.5]]
    case = one("bent sensors", "position play")
    data = made(case)
    true, given = data.exact["train"].columns["y"], data.train.states["y"]
    half = case.size * np.abs(true).max()
    assert np.abs(given - true).max() == pytest.approx(half)
    assert 0.02 <= case.size <= 0.05 and np.mean(np.diff(given) == 0.0) > 0.01


@pytest.mark.parametrize("hides", [False, True])
def test_a_zero_that_is_off_is_an_offset_on_a_spring_that_is_not_linear(hides):
    case = one("bent sensors", "position zero", hides=hides)
    data = made(case)
    true = data.exact["train"].columns["y"]
    np.testing.assert_allclose(data.train.states["y"] - true, 0.2 * rms(true))
    assert data.simulation["ydot"].count("y**3") == 1
    assert [(suspect.name, suspect.channels) for suspect in data.suspects] == [("offset", ("y",))]
    found = {"family": case.family, "suspects": [{**LATE, "name": "offset", "channels": ["y"], "samples": None}]}
    assert assumption_scores(row(**found, instrument=[fault("offset", "y")]))["instrument found"]
    assert not assumption_scores(row(**found, instrument=[fault("offset", "rate")]))["instrument found"]


def test_an_accelerometer_that_is_coupled_loses_slow_motion():
    step, corner = 0.02, 0.1
    times = step * np.arange(40_000)
    for frequency in (0.02, 0.1, 1.0):
        passed = sensors.high_passed(np.sin(2 * np.pi * frequency * times)[None], corner, step)[0]
        left = np.abs(passed[len(passed) // 2 :]).max()
        assert left == pytest.approx(frequency / np.hypot(frequency, corner), rel=1e-2)
    case = one("bent sensors", "AC-coupled rate", host="machine")
    data = made(case)
    own = np.sqrt(-data.true_rates["ydot"]["y"]) / (2 * np.pi)
    passed = sensors.high_passed(data.exact["train"].rates["ydot"][None], case.size * own, data.host.times[1])[0]
    assert rms(data.train.derivatives["ydot"] - passed) == pytest.approx(data.sigma, rel=0.1)
    assert rms(rate_noise(data)) > 2 * data.sigma


@pytest.mark.parametrize("hides", [False, True])
def test_a_brake_drags_for_a_part_of_the_record_and_in_the_motion_too(hides):
    case = one("for a moment", "brake", hides=hides)
    data = made(case)
    exact = data.exact["train"]
    brake = beside_what_is_hidden(data)
    braked = np.flatnonzero(np.abs(brake) > 1e-9)
    assert len(braked) / data.train.n_obs == pytest.approx(case.size, abs=2 / data.train.n_obs)
    assert np.ptp(braked) == len(braked) - 1
    assert np.all((brake * exact.columns["ydot"])[braked] < 0.0) and rms(brake[braked]) > 10 * data.sigma
    path, rate, step = exact.columns["ydot"], exact.rates["ydot"], data.host.times[1]
    slope = (path[:-4] - 8 * path[1:-3] + 8 * path[3:-1] - path[4:]) / (12 * step)
    within = slice(braked[3] - 2, braked[-3] - 2)
    assert np.quantile(np.abs(slope - rate[2:-2])[within], 0.5) < 1e-2 * np.abs(rate).max()
    assert set(data.excused) == {"coulomb-friction", "smooth-friction"} and data.silent == ()


@pytest.mark.parametrize("case", [case for case in CASES if case.breach == "end stop"], ids=lambda case: case.key)
def test_an_end_stop_is_touched_on_one_side_in_few_rows(case):
    data = made(case)
    force, y = beside_what_is_hidden(data), data.exact["train"].columns["y"]
    touched = force < -1e-9 * np.abs(force).max()
    assert 0.02 <= np.mean(touched) <= 0.04
    assert y[touched].min() >= y[~touched].max() > 0.0
    assert np.abs(force).max() > 10 * data.sigma
    assert data.silent == () and data.suspects == () and all(truth.ratio > 1.0 for truth in data.effects)


def test_an_input_is_misread_now_and_then():
    case = one("for a moment", "input outliers", hides=True)
    data = made(case)
    for part, given in (("train", data.train), ("test", data.test)):
        true = data.exact[part].columns["F"]
        wrong = given.inputs["F"] != true
        assert np.mean(wrong) == pytest.approx(0.03, abs=1e-3)
        factors = given.inputs["F"][wrong] / true[wrong]
        assert factors.min() >= for_a_moment.MISREAD_LEAST and factors.max() <= for_a_moment.MISREAD_MOST
    np.testing.assert_array_equal(data.train.states["y"], data.exact["train"].columns["y"])


def test_bent_sensors_may_be_anything_but_named():
    data = made(one("bent sensors", "position compresses"))
    silent = {"family": data.case.family, "truth": (), "silent": list(data.silent), "excused": list(data.excused)}
    for verdict, right in (("instrument", True), ("unknown", True), ("partly named", True), ("named", False)):
        assert assumption_scores(row(**silent, verdict=verdict))["silent"] is right
    for verdict, probability, wrong in (
        ("partly named", 0.6, False),
        ("partly named", 0.95, True),
        ("named", 0.6, True),
    ):
        scores = assumption_scores(row(**silent, verdict=verdict, effects=[effect("cubic-stiffness", probability)]))
        assert scores["wrong above 0.9"] is wrong
    coulomb = one("bent sensors", hides=True, effects=("coulomb-friction",))
    assert made(coulomb).accepted == (("coulomb-friction", "smooth-friction"),)


def test_peers_see_what_is_measured():
    data = made(one("noisy states", size=0.05))
    book = peers.candidate_terms(data)
    y = data.train.states["y"]
    np.testing.assert_allclose(book.columns[:, 1], y / rms(y))
    assert "smooth-friction" in book.slugs


# Scores


def effect(slug, probability=0.99, status="added"):
    numbers = {"probability": probability, "mean": 1.0, "sd": 0.1, "lower": 0.8, "upper": 1.2}
    return {"slug": slug, **numbers, "status": status, "tied_with": []}


def fault(suspect, channel="rate", probability=0.9, samples=0.5, half=0.1, status=""):
    delay = {"samples": samples, "lower_samples": samples - half, "upper_samples": samples + half}
    return {"suspect": suspect, "channel": channel, "probability": probability, "status": status, **delay}


def row(family="delay", truth=("a",), verdict="named", effects=(), instrument=None, suspects=(), **more):
    about = {
        **{"family": family, "effects": list(truth), "key": f"{family}/{len(more)}", "breach": "x", "size": 0.5},
        **{"domain": "mechanical", "host": "machine", "noise": 0.02, "rows": 601, "off": None, "closable": None},
        "truth": [{"slug": slug, "coefficient": 1.0, "inner": None, "ratio": 5.0, "wanted": 5.0} for slug in truth],
        **{"accepted": [[slug] for slug in truth], "excused": [], "silent": ["no gap", "instrument"]},
        **{"suspects": list(suspects), "oracle": None, "ratios": [5.0] * len(truth)},
    }
    study = {"verdict": verdict, "effects": list(effects), "instrument": instrument, "seconds": 2.0}
    study |= {"sentence": more.pop("sentence", None), "free_run": more.pop("free_run", {})}
    study["elsewhere"] = more.pop("elsewhere", [])
    return {**about, "study": study, **more}


LATE = {"name": "delay", "channels": ["rate"], "samples": 0.5, "either": False}


@pytest.mark.parametrize(
    ("truth", "verdict", "effects", "right", "wrong", "surely"),
    [
        (("a",), "named", [effect("a")], True, False, False),
        (("a",), "named", [effect("a"), effect("b", 0.5)], True, True, True),
        (("a",), "partly named", [effect("a"), effect("b", 0.5)], True, True, False),
        (("a",), "partly named", [effect("b"), effect("a")], False, True, True),
        (("a",), "one of", [effect("a", 0.6), effect("b", 0.3, "")], True, False, False),
        (("a",), "unknown", [effect("b", 0.95, "")], False, False, True),
        (("a", "c"), "partly named", [effect("c"), effect("a")], True, False, False),
        (("a", "c"), "named", [effect("a")], False, False, False),
        ((), "no gap", [effect("b", 0.3, "")], None, False, False),
    ],
)
def test_right_and_wrong_names(truth, verdict, effects, right, wrong, surely):
    found = assumption_scores(row(truth=truth, verdict=verdict, effects=effects))
    assert (found["right"], found["wrong"], found["wrong above 0.9"]) == (right, wrong, surely)


def test_names_that_no_data_could_tell_apart_are_excused_but_not_in_another_equation():
    told = row("sensor", (), "named", [effect("b")], excused=["b"])
    assert not case_scores.wrong_names(told) and len(case_scores.stated([told])[0]) == 0
    assert case_scores.wrong_names(row(verdict="no gap", elsewhere=[{"equation": "y", **effect("a")}])) == {"a"}
    accepted = row("smooth friction", ("a",), effects=[effect("b")], accepted=[["a", "b"]])
    assert assumption_scores(accepted)["right"] and case_scores.stated([accepted])[1].all()


@pytest.mark.parametrize(
    ("instrument", "found", "covered"),
    [
        (None, False, None),
        ([fault("delay")], True, True),
        ([fault("delay", probability=0.2)], False, None),
        ([fault("delay", probability=0.2, status="in the model")], True, True),
        ([fault("delay", samples=-0.5)], True, False),
        ([fault("delay", channel="F")], False, None),
        ([fault("gain")], False, None),
    ],
)
def test_the_instrument(instrument, found, covered):
    scores = assumption_scores(row(instrument=instrument, suspects=[LATE]))
    assert (scores["instrument found"], scores["delay covered"]) == (found, covered)
    free = row(instrument=[fault("delay", "y", samples=-0.5)], suspects=[{**LATE, "either": True}])
    assert assumption_scores(free)["delay covered"]


@pytest.mark.parametrize(
    ("sentence", "after", "denied"),
    [
        ("adding it closes 98 % of the gap on held-out data.", 0.2, True),
        ("adding it closes 98 % of the gap on held-out data.", None, True),
        ("adding it closes 98 % of the gap on held-out data.", 0.1, False),
        ("adding it closes 98 % of the gap, but the free run grows.", 0.2, False),
        ("Something is missing that the catalogue does not have.", 0.2, False),
    ],
)
def test_a_sentence_must_not_say_closed_where_the_free_run_says_no(sentence, after, denied):
    study = {"sentence": sentence, "free_run": {"y": {"before": 0.1, "after": after}}}
    assert claim_denied(study) is denied
    assert claim_denied({"sentence": sentence, "free_run": {}}) is None


def test_tables_and_bars_by_hand():
    quiet = {"verdict": "no gap", "truth": ()}
    rows = [
        row(effects=[effect("a")], instrument=[fault("delay")], suspects=[LATE]),
        row(effects=[effect("b")], instrument=[fault("delay", samples=2.0)], suspects=[LATE], n=1),
        row("heavy tails", **quiet),
        row("correlated noise", **{**quiet, "verdict": "instrument"}),
        row("memory", (), "unknown", silent=[], stlsq={"verdict": "named", "names": ["b"]}),
    ]
    scores = score(rows)
    table = scores["assumptions"]
    assert table.loc["delay", ["cases", "wrong above 0.9", "right", "delay covered"]].tolist() == [2, 0.5, 0.5, 0.5]
    assert table.loc["heavy tails", "silent"] == table.loc["correlated noise", "silent"] == 1.0
    assert np.isnan(table.loc["memory", "silent"]) and table.loc["memory", "stlsq wrong"] == 1.0
    assert table.loc["all", "cases"] == 5
    bars = scores["bars"]
    assert bars.loc["wrong names above 0.9, or in a verdict, all cases", "reached"] == pytest.approx(0.2)
    assert bars.loc["wrong names above 0.9, or in a verdict, worst family", "reached"] == pytest.approx(0.5)
    assert bars.loc["delays of half a step or more found", "holds"]
    assert bars.loc["no gap under noise that is not white and normal", "reached"] == 1.0
    assert bars.loc["nulls kept silent", "holds"] is None
    # Of two names said with 0.99 one is right.
    assert bars.loc["expected calibration error of all stated names", "reached"] == pytest.approx(0.49)
    assert scores["assumption_verdicts"].loc["memory", "unknown"] == 1.0
    assert scores["cases"].empty and len(scores["assumption_cases"]) == 5
    assert len(show(scores)) == 2


# The study's record, and the runner


def test_a_record_has_the_instrument_the_free_run_and_the_sentence():
    data = made(one("delay", "rate", 0.5))
    effects = pd.DataFrame([{**effect("a"), "equation": "ydot"}, {**effect("b"), "equation": "y"}])
    gaps = pd.DataFrame(
        [("test", "free-run NRMSE", "y", 0.2, np.inf), ("train", "free-run NRMSE", "y", 0.1, 0.1)],
        columns=["data", "metric", "variable", "before", "after"],
    )
    study = SimpleNamespace(
        verdict="instrument",
        effects=effects,
        hypotheses=pd.DataFrame({"probability": [0.5]}, index=pd.MultiIndex.from_tuples([("ydot", "no gap")])),
        ties=[],
        gap=gaps.set_index(["data", "metric", "variable"]),
        # As of a study that thinned its rows.
        traces={"ydot": SimpleNamespace(probability=np.zeros(7))},
        instrument=pd.DataFrame([{"equation": "ydot", **fault("delay")}]),
        sentence="It is late.",
    )
    found = record(study, data)
    json.dumps(found, allow_nan=False)
    assert found["instrument"][0]["lower_samples"] == pytest.approx(0.4)
    assert found["free_run"] == {"y": {"before": 0.2, "after": None}}
    assert found["sentence"] == "It is late." and found["elsewhere"][0]["slug"] == "b"
    assert found["overlap"]["iou"] is None
    study.instrument = study.sentence = None
    assert record(study, data)["instrument"] is None


def says_nothing(data):
    return {"verdict": "no gap", "effects": [], "instrument": None, "free_run": {}, "sentence": "", "seconds": 0.1}


def test_a_run_takes_both_kinds(tmp_path):
    smooth = one("smooth friction", hides=True, size=0.4)
    cases = (all_cases()[0], one("correlated noise"), one("memory", "Maxwell"), smooth)
    chosen, asked = to_solve(cases, Ways(says_nothing)), Asked(tmp_path, progress=False)
    scores = perform(HIDDEN_EFFECTS, chosen, asked)
    assert scores["assumptions"].loc["correlated noise", "silent"] == 1.0
    assert scores["assumptions"].loc["smooth friction", "right"] == 0.0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["cases"] == 4 and {entry["family"] for entry in summary["assumptions"]} >= {"memory", "all"}
    assert len(pd.read_csv(tmp_path / "assumption_cases.csv")) == 3
    lines = (tmp_path / "results.jsonl").read_text().splitlines()
    perform(HIDDEN_EFFECTS, chosen, asked)
    assert (tmp_path / "results.jsonl").read_text().splitlines() == lines
    assert not any("error" in json.loads(line) for line in lines)
