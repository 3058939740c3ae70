"""Tables of one equation, from a finding and draws that are written down by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
from bayes_greybox.discovery.hypotheses import Explanation, Round
from bayes_greybox.discovery.rounds import TIED, Finding, Step
from tiny_equation import CUBE, DEAD_ZONE, SQUARE, tiny_data, tiny_evaluations, tiny_model

from bayes_greybox.discovery.coefficients import Coefficients, alone
from bayes_greybox.discovery.equation import EquationStudy, study_equation
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.physics.catalogue.effects import Effect

CUBIC = {"hidden": lambda x: -(x**3), "noise": 0.05}
TWICE = Effect(slug="twice", name="Twice", domain="test", expression="2*r**3")
FIFTH = Effect(slug="fifth", name="Fifth", domain="test", expression="r**5")


def first_round(known, probabilities):
    """A first round with these probabilities; an effect's best column is its first."""
    columns = known.statistics.of_kind("effect")
    explanations = []
    for name, p in probabilities.items():
        own = [i for i in columns if known.name(i) == name]
        best = own[0] if own else None
        explanations.append(Explanation(name, tuple(own), float(np.log(p)), 100 + float(np.log(p)), best, 0.0, p / 2))
    return Round((), tuple(explanations))


def studied(known, probabilities, base=(), draws=None, inner=None, ties=None, steps=()):
    """Draws in user's units of the columns: free, corrections, then the effects of `base`."""
    statistics = known.statistics
    own = [*statistics.of_kind("free"), *statistics.of_kind("correction")]
    draws = np.zeros((4, len(own) + len(base))) if draws is None else np.asarray(draws, float)
    inner = np.tile(base, (len(draws), 1)) if inner is None else np.asarray(inner)
    inner = inner.reshape(len(draws), len(base)).astype(int)
    scale = np.array([[statistics.columns[i].scale for i in (*own, *row)] for row in inner])
    first = first_round(known, probabilities)
    finding = Finding(
        "named", tuple(base), (0.7,) * len(base), ties or ((),) * len(base), first, first, tuple(steps), 0.0, 0.0
    )
    study = object.__new__(EquationStudy)
    study.__dict__.update(
        statistics=statistics, evaluations=known, finding=finding, amendment=SimpleNamespace(sigma=0.05),
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


def test_an_added_effect_has_its_probability_given_the_others_and_the_rest_that_of_the_first_round(known):
    cube, _ = known.statistics.of_kind("effect")
    table = studied(known, FIRST, (cube,)).effects(tiny_data()).set_index("slug")
    assert table.loc["cube", "probability"] == 0.7
    assert table.loc["square", "probability"] == pytest.approx(0.3)


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


def test_hypotheses_are_those_of_the_first_round_by_name(known):
    table = studied(known, FIRST).hypotheses()
    assert table.loc[("x", "square"), "probability"] == pytest.approx(0.3)
    assert table.loc[("x", "square"), "log_evidence"] == pytest.approx(100 + np.log(0.3))
    assert table.loc[("x", "square"), "share_left"] == pytest.approx(0.15)


def test_a_correction_is_as_likely_as_draws_of_it_are_not_zero(known):
    row = studied(known, FIRST, draws=[[0.0], [0.0], [0.0], [-0.2]]).corrections(tiny_data()).loc[("x", "x")]
    assert row["probability"] == 0.25 and row["nominal"] == -1.0
    assert row["mean"] == pytest.approx(-0.05)


def test_free_terms_and_effects_are_no_corrections():
    free = tiny_evaluations([CUBE], **CUBIC, dictionary={"x": ["sin(3*x)"]})
    study = studied(free, {"cube": 0.9, "no gap": 0.1}, tuple(free.statistics.of_kind("effect")))
    assert study.corrections(tiny_data()).index.tolist() == [("x", "x")]


def test_a_rung_of_the_ladder_has_the_likeliest_explanation_and_its_runner_up(known):
    steps = [Step({"cube": 0.6, "no gap": 0.4}, "cube", 0.1), Step({"enough": 1.0}, "", 0.05)]
    table = studied(known, FIRST, steps=steps).ladder()
    assert table.loc[("x", 1), ["verdict", "added", "runner_up"]].tolist() == ["cube", "cube", "no gap"]
    assert table.loc[("x", 1), ["probability", "runner_up_probability", "share_left"]].tolist() == [0.6, 0.4, 0.1]
    assert table.loc[("x", 2), "runner_up"] == "" and np.isnan(table.loc[("x", 2), "runner_up_probability"])


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


@pytest.mark.parametrize(("sigma", "reach"), [(0.05, "1.25"), (0.5, "1.5")])
def test_tied_effects_that_part_beyond_the_data_come_with_the_nearest_place_where_they_do(sigma, reach):
    found = tie(FIFTH, sigma)
    assert found["slugs"] == ("cube", "fifth")
    # Each at its best, −1.01 x³ and −0.85 x⁵ are 0.63 apart at 1.25 and 3.1 at 1.5; four deviations are 0.2 or 2.
    assert f"measure up to |x| = {reach} (the data reach 1)" in found["advice"]


def test_tied_effects_that_never_part_need_more_data_or_less_noise():
    assert tie(TWICE)["advice"].startswith("More data of the same kind, or less noise")


# The study


@pytest.fixture(scope="module")
def nothing_missing():
    told = []
    model, data = tiny_model(dictionary={"x": ["cos(x)"]}), tiny_data(seed=1)
    return study_equation(model, data, "x", [], Odds(), 3, 0, False, told.append), told


def test_where_nothing_is_missing_no_coefficient_of_the_simulation_changes(nothing_missing):
    study, _ = nothing_missing
    kinds = np.array([study.statistics.columns[i].kind for i in study.coefficients.indices])
    assert study.finding.verdict == "no gap"
    assert not study.coefficients.draws[:, kinds == "correction"].any()
    assert study.coefficients.draws[:, kinds == "free"].all()
    assert (study.corrections(tiny_data())["probability"] == 0).all()


def test_the_threshold_of_a_gap_is_the_smaller_noise_of_before_and_after(nothing_missing):
    study, _ = nothing_missing
    assert study.map.threshold == study.trace.threshold <= study.amendment.sigma
    # The truth is 0.05, estimated to 9 %; four of them.
    assert study.trace.threshold == pytest.approx(0.05, rel=0.37)


def test_a_study_tells_what_it_is_doing(nothing_missing):
    assert nothing_missing[1] == ["weighing explanations", "mapping the gap"]
