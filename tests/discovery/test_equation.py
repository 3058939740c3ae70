"""Tables of one equation, from a finding and draws that are written down by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tiny_equation import (
    CUBE,
    DEAD_ZONE,
    SQUARE,
    forced,
    forced_model,
    forced_study,
    on,
    soft,
    studied_motion,
    tiny_data,
    tiny_evaluations,
    tiny_model,
)

import bayes_greybox.discovery.equation as module
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.checks.adequacy import LOO_PIT, WHITENESS, Check
from bayes_greybox.discovery.answer.checks.contradictions import with_noisy_states
from bayes_greybox.discovery.answer.checks.motion import MotionCheck
from bayes_greybox.discovery.answer.coefficients import Coefficients, alone
from bayes_greybox.discovery.answer.doubt import Doubt
from bayes_greybox.discovery.answer.equation_study import UNUSUAL, EquationStudy
from bayes_greybox.discovery.answer.finding import TIED, Finding, Place
from bayes_greybox.discovery.answer.weighed import STACKED, Weighed
from bayes_greybox.discovery.equation import study_equation
from bayes_greybox.discovery.evidence.evaluations import Evaluations
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.discovery.evidence.of_equation import sufficient_statistics
from bayes_greybox.discovery.evidence.with_discrepancy import Evaluator
from bayes_greybox.discovery.weighing.aligned import Aligned
from bayes_greybox.discovery.weighing.sets import PLAIN, RECALIBRATED, REST, Explanation
from bayes_greybox.discovery.weighing.worlds import World
from bayes_greybox.model.noise.noise_model import NoiseModel
from bayes_greybox.physics.catalogue.effects import Effect

CUBIC = {"hidden": lambda x: -(x**3), "noise": 0.05}
TWICE = Effect(slug="twice", name="Twice", domain="test", expression="2*r**3")
FIFTH = Effect(slug="fifth", name="Fifth", domain="test", expression="r**5")
STOPS = {"no gap": PLAIN, "recalibrate": RECALIBRATED, "unknown": REST}


def world_of(known, probabilities):
    """Explanations by name, "cube + square" or "cube & rest"; log evidences are 100 plus log probabilities."""
    columns = known.statistics.of_kind("effect")
    found = []
    for name, p in probabilities.items():
        body, kind = name.removesuffix(" & rest"), STOPS.get(name, REST if name.endswith(" & rest") else PLAIN)
        slugs = [] if name in STOPS else body.split(" + ")
        own = tuple(next(i for i in columns if known.name(i) == slug) for slug in slugs)
        share = 0.0 if kind != REST else 0.25 if own else 1.0
        found.append(Explanation((), own, kind, float(np.log(p)), 100 + float(np.log(p)), share))
    found.sort(key=lambda e: -e.log_weight)
    return World(NoiseModel(known.statistics.rows.noise), known, tuple(found), 0.0)


def studied(known, probabilities, base=(), draws=None, inner=None, ties=None, verdict="named", checks=()):
    """Draws in user's units of the columns: free, corrections, then the effects of `base`."""
    statistics = known.statistics
    own = [*statistics.of_kind("free"), *statistics.of_kind("correction")]
    draws = np.zeros((4, len(own) + len(base))) if draws is None else np.asarray(draws, float)
    inner = np.tile(base, (len(draws), 1)) if inner is None else np.asarray(inner)
    inner = inner.reshape(len(draws), len(base)).astype(int)
    scale = np.array([[statistics.columns[i].scale for i in (*own, *row)] for row in inner])
    world = world_of(known, probabilities)
    places = tuple(
        Place(i, known.name(i), 0.7, tied, 0.9, ())
        for i, tied in zip(base, ties or ((),) * len(base), strict=True)
    )  # fmt: skip
    finding = Finding([world], verdict, places, world.best, world, 0.0, 0.0, Weighed([world]))
    study = object.__new__(EquationStudy)
    study.__dict__.update(
        finding=finding, amendment=SimpleNamespace(sigma=0.05), checks=tuple(checks),
        coefficients=Coefficients(
            (*own, *base), draws * scale / statistics.target_scale, inner, np.full(len(draws), 0.1)
        ),
    )  # fmt: skip
    return study


@pytest.fixture(scope="module")
def known():
    return tiny_evaluations([CUBE, SQUARE], **CUBIC)


@pytest.fixture(scope="module")
def zones():
    return tiny_evaluations([DEAD_ZONE, CUBE], **CUBIC)


FIRST = {"cube": 0.6, "square": 0.3, "no gap": 0.1}


# Effects


def test_effects_that_were_added_come_first_and_are_marked(known):
    cube, square = known.statistics.of_kind("effect")
    table = studied(known, FIRST, (square,)).effects(tiny_data())
    assert table["slug"].tolist() == ["square", "cube"]
    assert table["status"].tolist() == ["added", ""]


def test_what_is_no_effect_is_not_among_them(known):
    assert "no gap" not in studied(known, FIRST).effects(tiny_data())["slug"].tolist()


def test_an_added_effect_has_the_moments_of_its_draws_in_the_users_units(known):
    (cube, _), values = known.statistics.of_kind("effect"), np.array([-0.7, -0.9, -1.1, -1.3])
    row = studied(known, FIRST, (cube,), np.column_stack([np.zeros(4), values])).effects(tiny_data()).iloc[0]
    low, high = np.quantile(values, [0.05, 0.95])
    assert tuple(row[["mean", "sd", "lower", "upper"]]) == pytest.approx((-1.0, values.std(), low, high))


@pytest.mark.parametrize(
    ("words", "against", "said"),
    [("softens", 1.0, "softens"), ("", 1.0, UNUSUAL), ("softens", 0.96, "softens"), ("softens", 0.9, "")],
)
def test_an_effect_whose_sign_is_surely_the_other_one_says_what_that_means(words, against, said):
    known = tiny_evaluations([replace(CUBE, sign=-1, reverse=words), SQUARE], **CUBIC)
    cube, square = known.statistics.of_kind("effect")
    values = np.where(np.arange(100) < 100 * against, 0.5, -0.5)
    columns = np.column_stack([np.zeros(100), values, values])
    table = studied(known, FIRST, (cube, square), columns).effects(tiny_data()).set_index("slug")
    # Of one that is ordinary with either sign there is nothing to say.
    assert table["reverse"].to_dict() == {"cube": said, "square": ""}


def test_a_coefficient_is_averaged_over_inner_parameters_in_the_units_of_each(zones):
    first, *_, last = zones.statistics.of_kind("effect")[:8]
    draws = [[0.0, -1.0], [0.0, -1.0], [0.0, -2.0], [0.0, -2.0]]
    study = studied(zones, {"dead-zone": 0.9, "no gap": 0.1}, (first,), draws, [first, first, last, last])
    row = study.effects(tiny_data()).iloc[0]
    assert row["mean"] == pytest.approx(-1.5) and row["sd"] == pytest.approx(0.5)


def test_an_inner_parameter_is_averaged_over_draws(zones):
    first, *_, last = zones.statistics.of_kind("effect")[:8]
    low, high = (zones.statistics.columns[i].inner["gap"] for i in (first, last))
    study = studied(zones, {"dead-zone": 0.9, "no gap": 0.1}, (first,), None, [first, last, last, last])
    row = study.effects(tiny_data()).iloc[0]
    assert row["inner"]["gap"] == pytest.approx((low + 3 * high) / 4)
    assert f"{row['inner']['gap']:.4g}" in row["expression"]


def test_an_added_effect_has_the_probability_of_its_place_and_the_others_theirs(known):
    cube, _ = known.statistics.of_kind("effect")
    table = studied(known, FIRST, (cube,)).effects(tiny_data()).set_index("slug")
    assert table.loc["cube", "probability"] == 0.7
    assert table.loc["square", "probability"] == pytest.approx(0.3)


@pytest.mark.parametrize(("verdict", "status"), [("one of", "one of"), ("named", "")])
def test_what_could_stand_in_an_effects_place_is_marked_where_it_is_one_of_them(known, verdict, status):
    cube, _ = known.statistics.of_kind("effect")
    table = studied(known, FIRST, (cube,), ties=(("square",),), verdict=verdict).effects(tiny_data()).set_index("slug")
    assert table.loc["square", "status"] == status and table.loc["cube", "tied_with"] == ("square",)


def test_the_same_effect_on_other_columns_has_a_row_of_its_own_where_it_may_stand_in_its_place():
    data = forced(soft)
    statistics = sufficient_statistics(forced_model(), data, "v", [on(CUBE, "y"), on(CUBE, "v")])
    both = Evaluations(statistics, Odds(), Evaluator(statistics.prior, statistics.kernel, np.ones((5, 2))))
    first, second = statistics.of_kind("effect")
    study = studied(both, {"cube": 0.6, "no gap": 0.1}, (first,), ties=(("cube(r=v)",),), verdict="one of")
    world = study.finding.world
    again = replace(world.best, effects=(second,), log_weight=float(np.log(0.3)))
    study.finding.__dict__["weighed"] = Weighed([replace(world, explanations=(*world.explanations, again))])
    rows = study.effects(data)
    assert rows["status"].tolist() == ["added", "one of"] and rows["quantity"].tolist() == ["y", "v"]
    assert rows["probability"].tolist() == [0.7, pytest.approx(0.3)] and "v" in rows.loc[1, "expression"]
    (tie,) = study.ties(data)
    assert tie["slugs"] == ("cube", "cube(r=v)") and tie["advice"]


def test_an_effect_of_the_table_has_the_probability_that_a_rest_leaves_it(known):
    given = {"no gap": 0.1, "cube": 0.4, "cube & rest": 0.5}
    table = studied(known, given).effects(tiny_data()).set_index("slug")
    assert table.loc["cube", "probability"] == pytest.approx(0.4 + 0.5 * (1 - 0.25**0.5))


def test_an_effect_that_was_not_added_has_the_coefficient_that_it_would_have_alone(known):
    cube, _ = known.statistics.of_kind("effect")
    row = studied(known, FIRST).effects(tiny_data()).set_index("slug").loc["cube"]
    mean, sd = alone(known, cube)
    unit = known.statistics.target_scale / known.statistics.columns[cube].scale
    assert row["mean"] == pytest.approx(unit * mean) and row["sd"] == pytest.approx(unit * sd)
    # 90 % of a normal distribution is within 1.645 standard deviations.
    assert (row["lower"], row["upper"]) == pytest.approx((unit * (mean - 1.645 * sd), unit * (mean + 1.645 * sd)), 1e-3)
    assert row["lower"] < row["mean"] < row["upper"]


@pytest.mark.parametrize(("factor", "tied"), [(1.01, ("cube",)), (0.99, ())])
def test_an_effect_that_was_not_added_is_tied_from_a_share_of_the_best_ones_probability(known, factor, tied):
    first = {"no gap": 0.1, "cube": 0.5, "square": factor * TIED * 0.5}
    table = studied(known, first).effects(tiny_data()).set_index("slug")
    assert table.loc["square", "tied_with"] == tied


# Other tables


def test_hypotheses_are_stops_and_sets_of_effects_by_name(known):
    table = studied(known, FIRST).hypotheses()
    assert table.loc[("x", "square"), "probability"] == pytest.approx(0.3)
    assert table.loc[("x", "square"), "log_evidence"] == pytest.approx(100 + np.log(0.3))
    assert table.loc[("x", "square"), "share_left"] == 0.0
    assert {"no gap", "recalibrate", "instrument", "unknown"} <= set(table.index.get_level_values("hypothesis"))


@pytest.mark.parametrize(
    "given",
    [
        {"no gap": 0.2, "recalibrate": 0.1, "unknown": 0.1, "cube": 0.2, "square & rest": 0.4},
        {"no gap": 0.1, "cube + square": 0.5, "cube + square + fifth": 0.4},
    ],
)
def test_probabilities_of_hypotheses_add_up_to_one(given):
    known = tiny_evaluations([CUBE, SQUARE, FIFTH], **CUBIC)
    table = studied(known, given).hypotheses()
    assert table["probability"].sum() == pytest.approx(1.0)
    if "cube + square + fifth" in given:
        assert table.loc[("x", "cube + fifth + square"), "probability"] == pytest.approx(0.4 * (1 - STACKED))


def test_checks_are_listed_with_what_they_say(known):
    checks = [Check("whiteness", 1e-5, "residuals hang together over 0.4 s"), Check("LOO-PIT", 0.3, "")]
    table = studied(known, FIRST, checks=checks).check_table()
    assert table.loc[("x", "whiteness"), ["p", "ok", "text"]].tolist() == [
        1e-5,
        False,
        "residuals hang together over 0.4 s",
    ]
    assert table.loc[("x", "LOO-PIT"), "ok"] and table["khat"].isna().all()
    assert studied(known, FIRST).check_table().empty


def test_a_correction_is_as_likely_as_draws_of_it_are_not_zero(known):
    row = studied(known, FIRST, draws=[[0.0], [0.0], [0.0], [-0.2]]).corrections(tiny_data()).loc[("x", "x")]
    assert row["probability"] == 0.25 and row["nominal"] == -1.0
    assert row["mean"] == pytest.approx(-0.05)


def test_free_terms_and_effects_are_no_corrections():
    free = tiny_evaluations([CUBE], **CUBIC, dictionary={"x": ["sin(3*x)"]})
    study = studied(free, {"cube": 0.9, "no gap": 0.1}, tuple(free.statistics.of_kind("effect")))
    assert study.corrections(tiny_data()).index.tolist() == [("x", "x")]


def test_a_rung_of_the_ladder_has_the_likeliest_set_of_its_size_and_its_runner_up(known):
    given = {"no gap": 0.05, "recalibrate": 0.02, "cube": 0.5, "square": 0.03, "cube + square": 0.4}
    table = studied(known, given).ladder()
    assert table["verdict"].tolist() == ["no gap", "cube", "cube + square"]
    assert table["added"].tolist() == ["", "cube", "square"]
    assert table["runner_up"].tolist() == ["recalibrate", "square", ""]
    assert table["probability"].tolist() == pytest.approx([0.05, 0.5, 0.4])
    assert np.isnan(table.loc[("x", 3), "runner_up_probability"])
    # The cube is the gap: without it all is left, with it but noise.
    assert table.loc[("x", 1), "share_left"] > 0.9 > 0.1 > table.loc[("x", 2), "share_left"]


def test_larger_sets_that_are_next_to_impossible_are_no_rung(known):
    cube, _ = known.statistics.of_kind("effect")
    given = {"no gap": 0.1, "cube": 0.9, "cube + square": 1e-5}
    assert len(studied(known, given, ()).ladder()) == 2
    # One beyond the answer is always shown
    assert len(studied(known, given, (cube,)).ladder()) == 3


# Ties


def tie(rival, sigma=0.05):
    known = tiny_evaluations([CUBE, rival], **CUBIC)
    cube, _ = known.statistics.of_kind("effect")
    study = studied(known, {"cube": 0.6, rival.slug: 0.4}, (cube,), ties=((rival.slug,),))
    study.amendment.sigma = sigma
    (found,) = study.ties(tiny_data(**CUBIC))
    return found


def test_without_a_tie_no_experiment_is_advised(known):
    cube, _ = known.statistics.of_kind("effect")
    assert studied(known, FIRST, (cube,)).ties(tiny_data()) == []
    # A sensor's error has no curve to measure elsewhere: another sensor tells.
    (found,) = studied(known, FIRST, (cube,), ties=(("offset of d(x)/dt",),)).ties(tiny_data())
    assert "offset of d(x)/dt" in found["slugs"] and "another one beside it" in found["advice"]


@pytest.mark.parametrize(("sigma", "reach"), [(0.05, "1.25"), (0.5, "1.5")])
def test_tied_effects_that_part_beyond_the_data_come_with_the_nearest_place_where_they_do(sigma, reach):
    found = tie(FIFTH, sigma)
    assert found["slugs"] == ("cube", "fifth")
    # Each at its best, −1.01 x³ and −0.85 x⁵ are 0.63 apart at 1.25 and 3.1 at 1.5; four deviations are 0.2 or 2.
    assert f"measure up to |x| = {reach} (the data reach 1)" in found["advice"]


def test_tied_effects_that_never_part_need_more_data_or_less_noise():
    assert tie(TWICE)["advice"].startswith("More data of the same kind, or less noise")


# The study


def drifting():
    """ẋ = −x along its own path."""
    t, rng = 0.05 * np.arange(60), np.random.default_rng(1)
    x = np.exp(-t)
    return Trajectories.from_arrays(t, states={"x": x}, derivatives={"x": -x + 0.05 * rng.standard_normal(60)})


@pytest.fixture(scope="module")
def nothing_missing():
    told = []
    model, data = tiny_model(dictionary={"x": ["cos(x)"]}), drifting()
    return study_equation(model, data, "x", [], Odds(), 3, 0, False, told.append), told


def test_where_nothing_is_missing_no_coefficient_of_the_simulation_changes(nothing_missing):
    study, _ = nothing_missing
    kinds = np.array([study.statistics.columns[i].kind for i in study.coefficients.indices])
    assert study.finding.verdict == "no gap"
    assert not study.coefficients.draws[:, kinds == "correction"].any()
    assert study.coefficients.draws[:, kinds == "free"].all()
    assert (study.corrections(tiny_data())["probability"] == 0).all()


def test_a_recalibration_is_told_by_draws_in_which_a_coefficient_is_changed():
    # Unlikely enough that the coefficient is right in many draws of all that is possible.
    study = study_equation(
        tiny_model(), tiny_data(lambda x: -0.06 * x), "x", [], Odds(), 3, 0, False, lambda text: None
    )
    row = study.corrections(tiny_data()).iloc[0]
    assert study.finding.verdict == "recalibrate" and row["probability"] == 1.0
    assert study.finding.weighed.by_kind["recalibrate"] < 0.999 and row["lower"] < -0.06 < row["upper"]


HEAVY = {"simulation": {"y": "v", "v": "1.06*F - 2.12*y - 0.159*v"}}
"""The motion as of a mass that is 6 % too small."""


def reading(gain):
    """The motion with nothing missing, its rate read by a sensor with a gain."""
    data = forced()
    return replace(data, derivatives={"v": gain * data.derivatives["v"]})


@pytest.mark.slow
def test_a_wrong_mass_is_a_recalibration_and_no_gain_of_the_rates_sensor():
    study = studied_motion(forced(), **HEAVY)
    assert (study.finding.verdict, study.finding.against) == ("recalibrate", ())
    # The samples of v deny the gain, and nothing is left of it.
    found = study.finding.weighed
    assert found.by_kind["recalibrate"] > 0.9 and found.by_kind["instrument"] < 0.01
    table = study.corrections(forced())
    np.testing.assert_allclose(table["mean"] / table["nominal"], 1 / 1.06 - 1, atol=4 * 0.003)
    assert np.ptp(table["mean"] / table["nominal"]) < 1e-3


@pytest.mark.parametrize("gain", [0.94, 1.03])
def test_a_gain_of_the_rates_sensor_is_told_where_samples_deny_a_wrong_mass(gain):
    study = studied_motion(reading(gain))
    assert (study.finding.verdict, study.finding.against) == ("instrument", ())
    (row,) = study.instrument(forced()).query("suspect == 'gain'").to_dict("records")
    assert row["channel"] == "d(v)/dt" and row["status"] and abs(row["mean"] - (gain - 1)) < 4 * row["sd"]


def test_where_no_sample_tells_a_wrong_mass_from_a_gain_both_are_likely():
    # So few rows that v has no window.
    study = studied_motion(forced(n=20, step=1.0), **HEAVY)
    found = study.finding.weighed.by_kind
    assert study.finding.verdict == "recalibrate" and min(found["recalibrate"], found["instrument"]) > 0.05


def test_the_threshold_of_a_gap_is_the_smaller_noise_of_before_and_after(nothing_missing):
    study, _ = nothing_missing
    assert study.map.threshold == study.trace.threshold <= study.amendment.sigma
    # The truth is 0.05, estimated to 9 %; four of them.
    assert study.trace.threshold == pytest.approx(0.05, rel=0.37)


def test_a_study_tells_what_it_is_doing(nothing_missing):
    told = nothing_missing[1]
    assert told[-1] == "mapping the gap" and "weighing sets of effects" in told


def test_a_delay_that_explains_the_gap_leaves_the_model_as_it_is():
    study = forced_study(False, "F")
    assert study.finding.verdict == "instrument" and not study.coefficients.draws.any()
    assert study.amendment.discrepancy is None and study.coefficients.suspect_draws.any()


def test_checks_of_what_is_right_do_not_speak_against_it():
    study = forced_study(True, "F")
    assert study.finding.verdict == "named" and study.finding.against == ()
    assert [check.name for check in study.checks] == [WHITENESS, LOO_PIT, "motion of y", "motion of v"]
    assert all(check.ok for check in study.checks)


@pytest.fixture(scope="module")
def bump():
    return studied_motion(forced(lambda y, v: 0.6 * np.exp(-(((y - 0.5) / 0.3) ** 2))), effects=(SQUARE,))


def test_where_something_remains_the_model_after_holds_f_and_only_sensors_are_checked(bump):
    study = bump
    assert study.finding.verdict == "unknown" and study.finding.base == ()
    assert [check.name for check in study.checks] == ["motion of y"]
    assert study.amendment.discrepancy is not None


@pytest.mark.parametrize("n_run", [1, 2])
def test_too_few_rows_to_say_anything_of_their_noise_still_name_a_plain_effect(n_run):
    study = studied_motion(forced(soft, n=16 // n_run, step=0.4, n_run=n_run))
    assert [place.slug for place in study.finding.places] == ["cube"] and study.checks == ()


def test_a_rate_that_never_changes_breaks_nothing():
    data = forced(n=40)
    flat = type(data).from_arrays(
        data.time, states=dict(data.states), inputs=dict(data.inputs), derivatives={"v": np.full(40, 0.3)}
    )
    assert studied_motion(flat).finding.verdict in ("unknown", "one of", "partly named")


@pytest.mark.parametrize("most", [1, 3])
def test_no_more_effects_than_asked_for(most):
    assert len(studied_motion(forced(soft), most=most).finding.places) == 1


def test_a_users_own_term_is_learned_beside_what_is_missing():
    data = forced(lambda y, v: soft(y, v) + 0.4 * np.cos(3 * y))
    study = studied_motion(data, dictionary={"v": ["cos(3*y)"]})
    assert [place.slug for place in study.finding.places] == ["cube"]
    (free,) = study.statistics.of_kind("free")
    unit = study.statistics.target_scale / study.statistics.columns[free].scale
    draws = study.coefficients.draws[:, study.coefficients.indices.index(free)] * unit
    assert abs(draws.mean() - 0.4) < 4 * draws.std()


# Noise left on states


def test_a_gap_that_noise_on_states_explains_is_judged_by_its_motion_too(monkeypatch):
    def as_noise(finding, aligned, unit):
        return replace(finding, verdict="instrument") if finding.verdict == "unknown" else finding

    monkeypatch.setattr(module, "with_noisy_states", as_noise)
    study = studied_motion(forced(lambda y, v: 0.6 * np.exp(-(((y - 0.5) / 0.3) ** 2))), effects=(SQUARE,))
    assert (study.finding.verdict, study.finding.kind) == ("instrument", "unknown")
    assert [check.name for check in study.checks] == ["motion of y", "motion of v"]


class Noisy(Aligned):
    """Data on which the noise left on y acts like a force of this size."""

    def __init__(self, size):
        self.__dict__.update(size=size, sample_noise={"y": None})

    @property
    def spurious(self):
        return self.size


def noisy(study, spurious):
    return with_noisy_states(study.finding, Noisy(spurious), "m/s²")


def test_noise_left_on_states_speaks_against_a_name_where_it_is_as_large_as_the_residuals():
    study = forced_study(True)
    capped = noisy(study, 0.015)
    assert capped.verdict == "partly named"
    assert capped.against == ("noise on the samples of y acts like a force of 0.015 m/s²",)
    assert noisy(study, 0.002) is study.finding


def test_a_gap_that_noise_left_on_states_explains_is_the_instruments(bump):
    assert noisy(bump, 2.0).verdict == "instrument"
    less = noisy(bump, 0.07)
    assert less.verdict == "unknown" and less.against


def test_no_answer_is_said_before_its_own_motion_has_judged_it(monkeypatch):
    asked = []

    def denying(model, train, aligned, amendment, finding, odds):
        asked.append(finding.kind)
        return [MotionCheck("motion of v", 0.0, f"{finding.kind} is denied", "v", 1.0, 1.0)], [
            Doubt(1.0, 1e6, finding.kind)
        ]

    monkeypatch.setattr(module, "contradictions", denying)
    for hidden, first in ((None, "no gap"), (soft, "effects")):
        asked.clear()
        study = studied_motion(forced(hidden) if hidden else forced())
        assert asked[0] == first and len(asked) == len(set(asked))
        assert study.finding.verdict == "unknown" and f"{first} is denied" in study.finding.against
