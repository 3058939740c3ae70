"""Tables of one equation, from a finding and draws that are written down by hand."""

from dataclasses import replace

import numpy as np
import pytest
from hand_made import AT, study_of, with_hypotheses
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
    tiny_model,
    tiny_near,
    tiny_study_of,
)

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.checks import LOO_PIT, WHITENESS, Check
from bayes_greybox.discovery.answer.equation_study import UNUSUAL
from bayes_greybox.discovery.decision.criteria import Criteria
from bayes_greybox.discovery.equation import Question, study_equation
from bayes_greybox.discovery.grid.sets import Reach
from bayes_greybox.discovery.grid.weigh import weigh
from bayes_greybox.discovery.linearise.near import Near, Point
from bayes_greybox.discovery.linearise.rates import RateRows
from bayes_greybox.discovery.linearise.visits import table_of
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.physics.catalogue.effects import Effect

CUBIC = {"hidden": lambda x: -(x**3), "noise": 0.05}
TWICE = Effect(slug="twice", name="Twice", domain="test", expression="2*r**3")
FIFTH = Effect(slug="fifth", name="Fifth", domain="test", expression="r**5")


def studied(near, probabilities, base=(), draws=None, inner=None, **given):
    return study_of(with_hypotheses(near, probabilities), base=base, draws=draws, inner=inner, **given)


@pytest.fixture(scope="module")
def known():
    return tiny_near([CUBE, SQUARE], **CUBIC)


@pytest.fixture(scope="module")
def zones():
    return tiny_near([DEAD_ZONE, CUBE], **CUBIC)


FIRST = {"cube": 0.6, "square": 0.3, "no gap": 0.1}


# Effects


def test_effects_that_were_added_come_first_and_are_marked(known):
    cube, square = known.regressors.of_kind("effect")
    table = studied(known, FIRST, (square,)).effects(tiny_data())
    assert table["slug"].tolist() == ["square", "cube"]
    assert table["status"].tolist() == ["added", ""]


def test_what_is_no_effect_is_not_among_them(known):
    assert "no gap" not in studied(known, FIRST).effects(tiny_data())["slug"].tolist()


def test_an_added_effect_has_the_moments_of_its_draws_in_the_users_units(known):
    (cube, _), values = known.regressors.of_kind("effect"), np.array([-0.7, -0.9, -1.1, -1.3])
    row = studied(known, FIRST, (cube,), np.column_stack([np.zeros(4), values])).effects(tiny_data()).iloc[0]
    low, high = np.quantile(values, [0.05, 0.95])
    assert tuple(row[["mean", "sd", "lower", "upper"]]) == pytest.approx((-1.0, values.std(), low, high))


@pytest.mark.parametrize(
    ("words", "against", "said"),
    [("softens", 1.0, "softens"), ("", 1.0, UNUSUAL), ("softens", 0.96, "softens"), ("softens", 0.9, "")],
)
def test_an_effect_whose_sign_is_surely_the_other_one_says_what_that_means(words, against, said):
    known = tiny_near([replace(CUBE, sign=-1, reverse=words), SQUARE], **CUBIC)
    cube, square = known.regressors.of_kind("effect")
    values = np.where(np.arange(100) < 100 * against, 0.5, -0.5)
    columns = np.column_stack([np.zeros(100), values, values])
    table = studied(known, FIRST, (cube, square), columns).effects(tiny_data()).set_index("slug")
    # Of one that is ordinary with either sign there is nothing to say.
    assert table["reverse"].to_dict() == {"cube": said, "square": ""}


def test_a_coefficient_is_averaged_over_inner_parameters_in_the_units_of_each(zones):
    first, *_, last = zones.regressors.of_kind("effect")[:8]
    draws = [[0.0, -1.0], [0.0, -1.0], [0.0, -2.0], [0.0, -2.0]]
    study = studied(zones, {"dead-zone": 0.9, "no gap": 0.1}, (first,), draws, [first, first, last, last])
    row = study.effects(tiny_data()).iloc[0]
    assert row["mean"] == pytest.approx(-1.5) and row["sd"] == pytest.approx(0.5)


def test_an_inner_parameter_is_averaged_over_draws(zones):
    first, *_, last = zones.regressors.of_kind("effect")[:8]
    low, high = (zones.regressors.columns[i].inner["gap"] for i in (first, last))
    study = studied(zones, {"dead-zone": 0.9, "no gap": 0.1}, (first,), None, [first, last, last, last])
    row = study.effects(tiny_data()).iloc[0]
    assert row["inner"]["gap"] == pytest.approx((low + 3 * high) / 4)
    assert f"{row['inner']['gap']:.4g}" in row["expression"]


def test_an_added_effect_has_the_probability_of_its_place_and_the_others_theirs(known):
    cube, _ = known.regressors.of_kind("effect")
    table = studied(known, FIRST, (cube,)).effects(tiny_data()).set_index("slug")
    assert table.loc["cube", "probability"] == 0.7
    assert table.loc["square", "probability"] == pytest.approx(0.3)


@pytest.mark.parametrize(("verdict", "status"), [("one of", "one of"), ("named", "")])
def test_what_could_stand_in_an_effects_place_is_marked_where_it_is_one_of_them(known, verdict, status):
    cube, _ = known.regressors.of_kind("effect")
    table = studied(known, FIRST, (cube,), ties=(("square",),), code=verdict).effects(tiny_data()).set_index("slug")
    assert table.loc["square", "status"] == status and table.loc["cube", "tied_with"] == ("square",)


def test_the_same_effect_on_other_columns_has_a_row_of_its_own_where_it_may_stand_in_its_place():
    data = forced(soft)
    rows = RateRows(forced_model(), data, "v", [on(CUBE, "y"), on(CUBE, "v")]).near(Point())
    near = Near(rows, weigh(table_of(rows), Odds(), Reach(), rows.floor))
    first, _ = near.regressors.of_kind("effect")
    given = {"cube(r=y)": 0.6, "cube(r=v)": 0.3, "no gap": 0.1}
    study = studied(near, given, (first,), ties=(("cube(r=v)",),), code="one of")
    rows = study.effects(data)
    assert rows["status"].tolist() == ["added", "one of"] and rows["quantity"].tolist() == ["y", "v"]
    assert rows["probability"].tolist() == [0.7, pytest.approx(0.3)] and "v" in rows.loc[1, "expression"]
    (tie,) = study.ties(data)
    assert tie["slugs"] == ("cube", "cube(r=v)") and tie["advice"]


def test_an_effect_of_the_table_has_the_probability_that_a_rest_leaves_it(known):
    given = {"no gap": 0.1, "cube": 0.4, "cube & rest": 0.5}
    table = studied(known, given).effects(tiny_data()).set_index("slug")
    # The cube is nearly all of the gap, whose RMS is one; what is left beside it has half of that.
    assert table.loc["cube", "probability"] == pytest.approx(0.4 + 0.5 / (1 + 0.25), abs=0.02)


def test_an_effect_that_was_not_added_has_the_coefficient_that_it_has_where_it_is_likeliest(known):
    cube, square = known.regressors.of_kind("effect")
    study = studied(known, {"cube": 0.5, "cube + square": 0.3, "no gap": 0.2})
    rows = study.effects(tiny_data()).set_index("slug")
    for name, h, k, index in (("cube", 0, 0, cube), ("square", 1, 1, square)):
        found = study.near.weighed.hypotheses[h]
        unit = known.regressors.target_scale / known.column(index).scale
        mean, sd = unit * found.mean[k], unit * found.sd[k]
        row = rows.loc[name]
        assert row["mean"] == pytest.approx(mean) and row["sd"] == pytest.approx(sd)
        # 90 % of a normal distribution is within 1.645 standard deviations.
        assert (row["lower"], row["upper"]) == pytest.approx((mean - 1.645 * sd, mean + 1.645 * sd), rel=1e-3)
    assert rows.loc["cube", "mean"] == pytest.approx(-1.0, abs=0.2)


def test_an_effect_that_is_in_no_hypothesis_has_the_coefficient_that_it_has_alone(known):
    row = studied(known, {"no gap": 1.0}).effects(tiny_data()).set_index("slug").loc["cube"]
    x, y = tiny_data().states["x"] ** 3, known.regressors.target * known.regressors.target_scale
    assert row["mean"] == pytest.approx(x @ y / (x @ x)) and row["probability"] == 0.0


def test_an_effect_has_its_agreement_and_its_family(known):
    study = studied(known, {"cube": (0.6, 0.4), "square": (0.3, 0.5), "no gap": (0.1, 0.1)})
    rows = study.effects(tiny_data()).set_index("slug")
    assert rows["agreement"].to_dict() == pytest.approx({"cube": 0.4, "square": 0.5})
    table = study.hypotheses()
    assert table.loc[("x", "cube"), "agreement"] == 0.4 and "family" in rows


@pytest.mark.parametrize(("factor", "tied"), [(1.01, ("cube",)), (0.99, ())])
def test_an_effect_that_was_not_added_is_tied_from_a_twentieth_of_the_best_ones_probability(known, factor, tied):
    first = {"no gap": 0.1, "cube": 0.5, "square": factor * 0.05 * 0.5}
    table = studied(known, first).effects(tiny_data()).set_index("slug")
    assert table.loc["square", "tied_with"] == tied


# Other tables


def test_hypotheses_are_stops_and_sets_of_effects_by_name(known):
    table = studied(known, FIRST).hypotheses()
    assert table.loc[("x", "square"), "probability"] == pytest.approx(0.3)
    assert table.loc[("x", "square"), "log_evidence"] == pytest.approx(AT + np.log(0.3))
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
    known = tiny_near([CUBE, SQUARE, FIFTH], **CUBIC)
    table = studied(known, given).hypotheses()
    assert table["probability"].sum() == pytest.approx(1.0)
    if "cube + square + fifth" in given:
        assert table.loc[("x", "cube + fifth + square"), "probability"] == pytest.approx(0.4 * 0.5)


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


def test_a_correction_has_the_probability_and_the_moments_of_the_hypotheses_that_have_it(known):
    study = studied(known, {"cube": (0.5, 0.6), "cube + x": 0.2, "recalibrate": (0.1, 0.05), "no gap": 0.2})
    row = study.corrections(tiny_data()).loc[("x", "x")]
    assert row["probability"] == pytest.approx(0.3, abs=1e-6) and row["nominal"] == -1.0
    assert row["agreement"] == pytest.approx(0.25, abs=1e-6)
    (index,) = known.regressors.of_kind("correction")
    own = [(h, h.members.index(index)) for h in study.near.weighed.hypotheses if index in h.members]
    means, sds = (np.array(each) for each in zip(*((h.mean[k], h.sd[k]) for h, k in own), strict=True))
    unit, weight = known.regressors.target_scale / known.column(index).scale, np.array([2 / 3, 1 / 3])
    mean = weight @ means
    assert row["mean"] == pytest.approx(unit * mean)
    assert row["sd"] == pytest.approx(unit * np.sqrt(weight @ (sds**2 + (means - mean) ** 2)))


def test_a_correction_that_is_in_no_hypothesis_is_none(known):
    row = studied(known, {"cube": 1.0}).corrections(tiny_data()).loc[("x", "x")]
    assert row["probability"] == row["mean"] == row["sd"] == 0.0


def test_what_has_no_name_is_told_by_its_kind_and_what_it_is_a_function_of(known):
    study = studied(known, {"cube & rest": 0.5, "cube": 0.3, "no gap": 0.2})
    memory = study.memory().droplevel(0)["probability"]
    assert memory["a law of the states"] == pytest.approx(0.5) and memory["something in time"] == 0.0
    assert study.quantities().loc[("x", "x"), "probability"] == pytest.approx(0.3 + 0.5 / 1.25, abs=0.02)


def test_free_terms_and_effects_are_no_corrections():
    free = tiny_near([CUBE], **CUBIC, dictionary={"x": ["sin(3*x)"]})
    study = studied(free, {"cube": 0.9, "no gap": 0.1}, tuple(free.regressors.of_kind("effect")))
    assert study.corrections(tiny_data()).index.tolist() == [("x", "x")]


def test_a_rung_of_the_ladder_has_the_likeliest_set_of_its_size_and_its_runner_up(known):
    given = {"no gap": 0.05, "recalibrate": 0.02, "cube": 0.5, "square": 0.03, "cube + square": 0.4}
    table = studied(known, given).ladder()
    assert table["verdict"].tolist() == ["no gap", "cube", "cube + square"]
    assert table["added"].tolist() == ["", "cube", "square"]
    assert table["runner_up"].tolist() == ["recalibrate", "square", ""]
    assert table["probability"].tolist() == pytest.approx([0.05, 0.5, 0.4])
    assert np.isnan(table.loc[("x", 3), "runner_up_probability"])
    # Nothing is left beside any of these.
    assert (table["share_left"] == 0.0).all()


def test_larger_sets_that_are_next_to_impossible_are_no_rung(known):
    cube, _ = known.regressors.of_kind("effect")
    given = {"no gap": 0.1, "cube": 0.9, "cube + square": 1e-5}
    assert len(studied(known, given, ()).ladder()) == 2
    # One beyond the answer is always shown
    assert len(studied(known, given, (cube,)).ladder()) == 3


# Ties


def tie(rival, sigma=0.05):
    known = tiny_near([CUBE, rival], **CUBIC)
    cube, _ = known.regressors.of_kind("effect")
    study = studied(known, {"cube": 0.6, rival.slug: 0.4}, (cube,), ties=((rival.slug,),))
    study.amendment.sigma = sigma
    (found,) = study.ties(tiny_data(**CUBIC))
    return found


def test_without_a_tie_no_experiment_is_advised(known):
    cube, _ = known.regressors.of_kind("effect")
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
    return study_equation(Question(model, data, "x", [], Odds(), 3, 0, Criteria()), told.append), told


def test_where_nothing_is_missing_no_coefficient_of_the_simulation_changes(nothing_missing):
    study, _ = nothing_missing
    kinds = np.array([study.regressors.columns[i].kind for i in study.coefficients.indices])
    assert study.verdict.code == "no gap"
    assert not study.coefficients.draws[:, kinds == "correction"].any()
    assert study.coefficients.draws[:, kinds == "free"].all()


def test_a_recalibration_is_told_by_draws_in_which_a_coefficient_is_changed():
    study = tiny_study_of([], tiny_data(lambda x: -0.06 * x, n=100))
    row = study.corrections(tiny_data()).iloc[0]
    assert study.verdict.code == "recalibrate" and row["lower"] < -0.06 < row["upper"]
    assert 0.5 < row["probability"] <= 1.0 and study.coefficients.draws.all()


HEAVY = {"simulation": {"y": "v", "v": "1.06*F - 2.12*y - 0.159*v"}}
"""The motion as of a mass that is 6 % too small."""


@pytest.mark.parametrize("gain", [0.94, 1.03])
def test_a_gain_of_the_rates_sensor_is_told_with_its_size(gain):
    data = forced()
    study = studied_motion(replace(data, derivatives={"v": gain * data.derivatives["v"]}))
    by_kind = study.probabilities.by_kind
    # A mass that is off does the same: three coefficients by one share.
    assert study.verdict.code == "instrument" and by_kind["instrument"] + by_kind["recalibrate"] > 0.8
    (row,) = study.instrument(forced()).query("suspect == 'gain' and channel == 'd(v)/dt'").to_dict("records")
    assert abs(row["mean"] - (gain - 1)) < 4 * row["sd"]


def test_a_wrong_mass_is_no_effect():
    """Rows of the rate alone cannot tell it from a gain of the rate's sensor, which is one number and not three."""
    study = studied_motion(forced(), **HEAVY)
    by_kind = study.probabilities.by_kind
    assert study.verdict.places == () and by_kind["recalibrate"] + by_kind["instrument"] > 0.8


def test_the_threshold_of_a_gap_is_the_noise_of_the_model_after_or_what_is_known_of_the_gap(nothing_missing):
    study, _ = nothing_missing
    known = np.median(study.trace.before_sd)
    assert study.map.threshold == study.trace.threshold == max(study.amendment.sigma, known)
    # The truth is 0.05, estimated to 9 %; four of them.
    assert study.trace.threshold == pytest.approx(0.05, rel=0.37)


def test_a_study_tells_what_it_is_doing(nothing_missing):
    told = nothing_missing[1]
    assert told[0] == "weighing hypotheses" and told[-1] == "mapping the gap"


def test_a_delay_that_explains_the_gap_leaves_the_model_as_it_is():
    study = forced_study(False, "F")
    assert study.verdict.code == "instrument" and not study.coefficients.draws.any()
    assert study.amendment.discrepancy is None and study.coefficients.suspect_draws.any()


@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize("channel", ["d(v)/dt", "states", "F"])
def test_half_a_step_of_delay_is_found_whatever_else_is_missing(channel, missing):
    study = forced_study(missing, channel)
    (key,) = study.verdict.sensors
    assert key == f"delay of {channel}"
    draws = study.coefficients.suspect_draws[:, 0]
    column = study.near.column(study.coefficients.suspects[0])
    delay = draws * study.regressors.target_scale / column.scale / 0.1
    # Four posterior standard deviations.
    assert abs(delay.mean() - 0.5) < 4 * delay.std() < 0.1
    assert [place.slug for place in study.verdict.places] == (["cube"] if missing else [])


def test_checks_of_what_is_right_do_not_speak_against_it():
    study = forced_study(True, "F")
    assert study.verdict.code == "named" and study.verdict.reasons == ()
    assert [check.name for check in study.checks] == [WHITENESS, LOO_PIT]
    assert all(check.ok for check in study.checks)


@pytest.fixture(scope="module")
def bump():
    return studied_motion(forced(lambda y, v: 0.6 * np.exp(-(((y - 0.5) / 0.3) ** 2))), effects=(SQUARE,))


def test_where_something_remains_the_model_after_holds_f_and_nothing_is_checked(bump):
    assert bump.verdict.code == "unknown" and bump.verdict.places == ()
    assert bump.checks == () and bump.amendment.discrepancy is not None


@pytest.mark.parametrize("n_run", [1, 2])
def test_too_few_rows_to_say_anything_of_their_noise_still_find_a_plain_effect(n_run):
    study = studied_motion(forced(soft, n=16 // n_run, step=0.4, n_run=n_run))
    assert next(iter(study.probabilities.by_effect)) == "cube" and study.checks == ()


def test_a_rate_that_never_changes_breaks_nothing():
    data = forced(n=40)
    flat = type(data).from_arrays(
        data.time, states=dict(data.states), inputs=dict(data.inputs), derivatives={"v": np.full(40, 0.3)}
    )
    study = studied_motion(flat)
    assert study.hypotheses()["probability"].sum() == pytest.approx(1.0)


@pytest.mark.parametrize("most", [1, 3])
def test_no_more_effects_than_asked_for(most):
    assert len(studied_motion(forced(soft), most=most).verdict.places) == 1


def test_a_users_own_term_is_learned_beside_what_is_missing():
    data = forced(lambda y, v: soft(y, v) + 0.4 * np.cos(3 * y))
    study = studied_motion(data, dictionary={"v": ["cos(3*y)"]})
    assert [place.slug for place in study.verdict.places] == ["cube"]
    (free,) = study.regressors.of_kind("free")
    unit = study.regressors.target_scale / study.regressors.columns[free].scale
    draws = study.coefficients.draws[:, study.coefficients.indices.index(free)] * unit
    assert abs(draws.mean() - 0.4) < 4 * draws.std()


def test_rows_at_the_end_of_a_sensor_count_for_nothing():
    data = forced(soft, n=300)
    top = np.quantile(data.derivatives["v"], 0.93)
    blind = replace(data, derivatives={"v": np.minimum(data.derivatives["v"], top)})
    study = studied_motion(blind)
    assert study.counted == np.sum(blind.derivatives["v"] != top) and study.regressors.rows.measured.max() < top
    assert [place.slug for place in study.verdict.places] == ["cube"]
    # Other data of that sensor lose their own rows.
    assert (
        study.amendment.corrected(blind).n_obs == study.counted and study.amendment.corrected(forced(n=50)).n_obs == 50
    )
