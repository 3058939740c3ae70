"""The rules of the verdict, one by one, on explanations whose probabilities are written down by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_greybox.data.noise.protocol import RowNoise
from bayes_greybox.discovery.answer.doubt import Doubt
from bayes_greybox.discovery.answer.finding import (
    AND_MORE,
    NEGLIGIBLE,
    SAME,
    SUBSTANTIAL,
    SURE,
    TIED,
    VERDICTS,
    decide,
)
from bayes_greybox.discovery.answer.weighed import EFFECTS, STACKED, STOPS, Mirror, Weighed
from bayes_greybox.discovery.evidence.evaluations import Evaluations
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.discovery.weighing.sets import PLAIN, RECALIBRATED, REST, Explanation
from bayes_greybox.discovery.weighing.worlds import World
from bayes_greybox.model.noise.noise_model import PROCESS, NoiseModel
from bayes_greybox.physics.catalogue.effects import ANSWERS

SUSPECTS = ("offset", "delay")
KINDS = {"no gap": PLAIN, "recalibrate": RECALIBRATED, "unknown": REST}


class Written(Evaluations):
    """Columns alone: the suspects, then effects by letters; a letter that occurs twice is bound in two ways."""

    curves = {}

    def apart(self, beside, first, second):
        """Written down for two letters, or for a letter and a suspect: "a offset"; others are far apart."""
        of = self.statistics.columns[second]
        other = of.effect.slug if of.suspect is None else f" {of.suspect.key}"
        return self.curves.get(self.name(first) + other, np.inf)

    def __init__(self, letters, on, inner):
        columns = [SimpleNamespace(effect=None, suspect=SimpleNamespace(key=key), inner={}) for key in SUSPECTS]
        for k, letter in enumerate(letters):
            column = on.get(letter, f"x{k}")
            effect = SimpleNamespace(slug=letter, names={"r": column}, label=f"{letter}(r={column})")
            values = {"v": 1.0} if letter in inner else {}
            formula = SimpleNamespace(states=())
            columns.append(SimpleNamespace(effect=effect, suspect=None, inner=values, formula=formula))
        effects = list(range(len(SUSPECTS), len(columns)))
        self.statistics, self.odds = SimpleNamespace(columns=columns, of_kind={"effect": effects}.get), Odds()


class Told(World):
    """A world whose explanations carry the share that is left themselves."""

    rms = {}

    def share_left(self, e):
        return e.share_left

    def sizes(self, e):
        letters = {i: self.evaluations.name(i) for i in e.effects}
        return {i: self.rms.get(letter, 1.0) for i, letter in letters.items()}


def world(table, letters="abcd", on=None, inner="", names=(), shares=None, apart=None, share=0.2, offset=0.0):
    """Explanations with these probabilities, by name: "a", "ab", "a & rest", "a ! offset", "! offset", or a stop."""
    found = []
    for name, p in table.items():
        body, kind = name, KINDS.get(name, PLAIN)
        if name in KINDS:
            body = ""
        if body.endswith(" & rest"):
            body, kind = body.removesuffix(" & rest"), REST
        body, _, suspects = body.partition("!")
        places = tuple(len(SUSPECTS) + letters.index(letter) for letter in body.strip())
        left = share if (kind == REST and places) or (PROCESS in names and places) else float(kind == REST)
        found.append(
            Explanation(
                tuple(SUSPECTS.index(s) for s in suspects.split()),
                places,
                kind,
                float(np.log(p)),
                float(np.log(p)),
                (shares or {}).get(name, left),
            )
        )
    found.sort(key=lambda e: -e.log_weight)
    noise = object.__new__(SimpleNoise)
    about = {name: {"share": 0.5} for name in names}
    known = Written(letters, on or {}, inner)
    known.curves = apart or {}
    return Told(NoiseModel(noise, names, 0.0, about), known, tuple(found), offset)


class SimpleNoise(RowNoise):
    """Noise that nobody asks anything."""

    n_white = log_det = whiten = whiten_transpose = precision_diagonal = precision_band = covariance = None  # type: ignore[assignment]
    restrict = to_dict = None  # type: ignore[assignment]


def decided(table, **given):
    return decide([world({"unknown": 1e-9} | table, **given)])


def slugs(finding):
    return tuple(place.slug for place in finding.places)


# First whether, then what


@pytest.mark.parametrize(("p", "expected"), [(0.51, "no gap"), (0.49, "one of")])
def test_no_gap_is_likelier_than_all_effects_together_or_it_is_not_said(p, expected):
    assert decided({"no gap": p, "a": 0.6 * (1 - p), "b": 0.4 * (1 - p)}).verdict == expected


def test_effects_together_beat_a_stop_that_each_of_them_alone_loses_to():
    finding = decided({"no gap": 0.4, "a": 0.35, "b": 0.25})
    assert slugs(finding) == ("a",) and finding.places[0].tied == ("b",)


def test_whether_something_is_missing_comes_before_what():
    # With a name or without against all that needs nothing, and only then the likeliest of these.
    assert decided({"no gap": 0.3, "recalibrate": 0.25, "a": 0.45}).verdict == "no gap"
    assert slugs(decided({"no gap": 0.45, "a": 0.3, "unknown": 0.25})) == ("a",)
    assert decided({"no gap": 0.45, "a": 0.25, "unknown": 0.3}).verdict == "unknown"
    assert decided({"no gap": 0.2, "! offset": 0.35, "a": 0.25, "unknown": 0.2}).verdict == "instrument"


@pytest.mark.parametrize("stop", ["no gap", "recalibrate", "unknown", "! offset"])
def test_the_likeliest_stop_is_the_verdict_and_names_no_effect(stop):
    finding = decided({"no gap": 0.1, "recalibrate": 0.1, "unknown": 0.1, "a": 0.3} | {stop: 0.4})
    assert finding.verdict == {"! offset": "instrument"}.get(stop, stop)
    assert finding.places == () and finding.base == ()


def test_what_an_instrument_explains_is_no_unknown():
    finding = decided({"! offset": 0.8, "no gap": 0.2})
    assert finding.verdict == "instrument" and finding.remainder < 1e-6
    assert [SUSPECTS[i] for i in finding.explanation.suspects] == ["offset"]


def test_a_recalibration_is_not_hidden_behind_a_suspect_beside_it():
    found = world({"no gap": 0.2, "! delay": 0.8})
    (delay,) = (e for e in found.explanations if e.suspects)
    weighed = Weighed([found])
    assert weighed.kind(found, delay) == "instrument"
    assert weighed.kind(found, Explanation(delay.suspects, (), RECALIBRATED, 0.0, 0.0)) == "recalibrate"


def test_without_effects_the_share_left_of_the_unknown_is_all_and_of_others_none():
    assert decided({"unknown": 0.9, "no gap": 0.1}).share_left == 1.0
    assert decided({"unknown": 0.1, "no gap": 0.9}).share_left == 0.0


# What a fault of the sensor does as well


def test_what_the_only_sensor_may_do_as_well_is_not_named():
    mirrors = {"a(r=x0)": Mirror("y", 0.5)}
    finding = decide([world({"a": 0.98, "b": 0.01, "unknown": 0.01})], (), mirrors)
    (place,) = finding.places
    assert finding.verdict == "one of" and place.slug == "a"
    assert place.tied == ("lag of y",) and place.same == ()
    assert place.probability == pytest.approx(0.49) and place.together == pytest.approx(0.98, abs=0.01)
    kinds = finding.weighed.by_kind
    assert sum(kinds.values()) == pytest.approx(1.0)
    assert kinds["instrument"] == pytest.approx(0.49) and kinds[EFFECTS] == pytest.approx(0.50)
    # Where the samples tell, it is named, or as good as excluded.
    assert decide([world({"a": 0.98, "b": 0.02})], (), {"a(r=x0)": Mirror("y", 0.01)}).verdict == "named"
    sure = decide([world({"a": 0.98, "b": 0.02})], (), {"a(r=x0)": Mirror("y", 1.0)})
    assert sure.verdict == "one of" and sure.places[0].tied == ("lag of y",) and sure.weighed.by_effect["a"] == 0.0


def test_a_set_is_the_sensors_only_where_all_of_it_is():
    weighed = decide([world({"ab": 0.97, "a": 0.03})], (), {"a(r=x0)": Mirror("y", 0.9)}).weighed
    assert weighed.by_kind[EFFECTS] >= weighed.by_effect["b"] == pytest.approx(0.97)
    assert weighed.by_effect["a"] == pytest.approx(0.1) and weighed.by_kind["instrument"] == pytest.approx(0.027)
    # What counts as unknown does so whichever of the two it is.
    table = {"a & rest": 0.8, "no gap": 0.1, "unknown": 0.1}
    without = decide([world(table, share=0.49)]).weighed.by_kind["unknown"]
    beside = decide([world(table, share=0.49)], (), {"a(r=x0)": Mirror("y", 0.9)}).weighed.by_kind["unknown"]
    assert beside == pytest.approx(without)


def test_on_two_columns_it_is_the_sensors_only_where_it_was_weighed():
    # "a" on both columns, in one answer: the sensor may do what it does on the first, and not on the second.
    letters, sure = "aa", {"a(r=x0)": Mirror("y", 1.0)}
    both = world({"a": 0.98, "unknown": 0.02}, letters)
    e, unknown = both.explanations
    places = tuple(len(SUSPECTS) + k for k in range(2))
    both = replace(both, explanations=(replace(e, effects=places), unknown))
    finding = decide([both], (), sure)
    assert [place.tied for place in finding.places] == [("lag of y",), ()]
    assert finding.weighed.by_effect["a"] == finding.weighed.by_mirror["a(r=x0)"] == pytest.approx(0.98)
    assert finding.weighed.by_kind["instrument"] == 0.0
    second = replace(both, explanations=(replace(e, effects=places[1:]), unknown))
    finding = decide([second], (), sure)
    assert finding.verdict == "named" and finding.weighed.by_effect["a"] == pytest.approx(0.98)


def test_no_effect_may_be_called_as_an_answer_without_one():
    assert set(STOPS) - {"no gap"} == set(ANSWERS)


# A name needs a probability


@pytest.mark.parametrize(("p", "expected"), [(SURE + 0.01, "named"), (SURE - 0.01, "one of")])
def test_a_name_needs_a_probability(p, expected):
    finding = decided({"a": p, "no gap": 1 - p})
    assert finding.verdict == expected and finding.places[0].probability == pytest.approx(p)


def test_one_of_comes_with_what_could_stand_in_its_place():
    (place,) = decided({"a": 0.5, "b": 0.3, "c": 0.15, "d": 0.1 * TIED, "no gap": 0.045}).places
    assert place.tied == ("b", "c") and place.together == pytest.approx(0.95, abs=0.01)


@pytest.mark.parametrize(("factor", "expected"), [(1.01, ("b",)), (0.99, ())])
def test_an_effect_is_tied_from_a_share_of_the_likeliest_ones_probability(factor, expected):
    assert decided({"a": 0.8, "b": factor * TIED * 0.8, "no gap": 0.1}).places[0].tied == expected


@pytest.mark.parametrize(("apart", "equal"), [(0.9 * SAME, True), (1.1 * SAME, False)])
def test_of_equal_curves_none_is_named_and_nothing_is_left(apart, equal):
    # Whatever their evidences: equal ones are an even chance, and no equal curves.
    finding = decided({"a": 0.5, "b": 0.45, "no gap": 0.05}, apart={"ab": apart})
    assert finding.verdict == "one of" and finding.open_ended != equal
    assert finding.places[0].same == (("b",) if equal else ())


def test_something_may_be_left_of_equal_curves_that_are_not_sure_together():
    finding = decided({"a": 0.45, "b": 0.4, "no gap": 0.15}, apart={"ab": 0.0})
    assert finding.verdict == "one of" and finding.open_ended


def test_something_may_be_left_of_a_tie_that_holds_another_curve_too():
    finding = decided({"a": 0.45, "b": 0.44, "c": 0.11}, apart={"ab": 0.0})
    assert finding.verdict == "one of" and finding.open_ended


def at_two_places(table):
    """A world in which "b" is the effect "a" on other columns."""
    found = world({"unknown": 1e-9} | table)
    other = found.evaluations.statistics.columns[len(SUSPECTS) + 1].effect
    other.slug, other.label = "a", f"a(r={other.names['r']})"
    return found


def test_an_effect_whose_columns_alone_are_open_is_one_of_its_places():
    finding = decide([at_two_places({"a": 0.52, "b": 0.39, "ab": 0.08, "no gap": 0.01})])
    (place,) = finding.places
    assert finding.verdict == "one of" and place.tied == ("a(r=x1)",) and place.same == ()
    assert place.probability == pytest.approx(0.60) and place.together == pytest.approx(0.99)
    assert finding.weighed.by_effect["a"] == pytest.approx(0.99)
    assert finding.weighed.by_place == {"a(r=x0)": pytest.approx(0.60), "a(r=x1)": pytest.approx(0.47)}
    assert decide([at_two_places({"a": 0.96, "b": 0.03, "no gap": 0.01})]).verdict == "named"


def test_the_probability_of_an_effect_is_summed_over_sets():
    finding = decided({"ab": 0.6, "ac": 0.35, "a": 0.05})
    first, second = finding.places
    assert (first.slug, first.probability) == ("a", pytest.approx(1.0))
    assert (second.slug, second.probability, second.tied) == ("b", pytest.approx(0.6), ("c",))
    assert finding.verdict == "one of"


def test_an_effect_at_two_places_is_counted_once():
    found = Weighed([world({"ab": 0.7, "no gap": 0.3}, letters="aab"), world({"no gap": 1.0}, offset=-50.0)])
    assert found.by_effect["a"] == pytest.approx(0.7)
    both = world({"ab": 0.7, "no gap": 0.3})
    again = Explanation((), (2, 3), PLAIN, np.log(0.7), 0.0)
    twice = Told(both.model, Written("aa", {}, ""), (again, both.explanations[1]), 0.0)
    assert Weighed([twice]).by_effect == {"a": pytest.approx(0.7)}


def test_an_effect_that_no_set_holds_is_listed_with_nothing():
    assert Weighed([world({"a": 0.9, "no gap": 0.1}, letters="ab")]).by_effect["b"] == 0.0


# The instrument in an effect's place


def test_an_offset_of_the_sensor_ties_with_a_constant_force():
    finding = decided({"a": 0.6, "! offset": 0.35, "no gap": 0.05})
    assert finding.verdict == "one of" and finding.places[0].tied == ("offset",)
    same = decided({"a": 0.6, "! offset": 0.35, "no gap": 0.05}, apart={"a offset": 0.0})
    assert same.verdict == "one of" and same.places[0].same == ("offset",)


def test_a_suspect_stands_in_the_place_of_one_effect_beside_the_others():
    first, second = decided({"ab": 0.6, "a ! offset": 0.35, "no gap": 0.05}).places
    assert first.tied == () and second.tied == ("offset",)


def test_a_suspect_that_is_beside_the_effect_stands_in_nobodys_place():
    (place,) = decided({"a ! delay": 0.85, "! delay": 0.1, "no gap": 0.05}).places
    assert place.tied == ()


def test_of_two_suspects_the_one_that_is_not_beside_the_effect_stands_in_its_place():
    (place,) = decided({"a ! delay": 0.7, "! offset delay": 0.3}).places
    assert place.tied == ("offset",)


def test_probabilities_of_suspects_are_summed_over_sets():
    found = Weighed([world({"a ! delay": 0.5, "! delay offset": 0.2, "a": 0.3})])
    assert found.by_suspect == {"delay": pytest.approx(0.7), "offset": pytest.approx(0.2)}


# What remains


@pytest.mark.parametrize(("p", "expected"), [(0.2, "named"), (0.3, "partly named"), (0.51, "partly named")])
def test_an_effect_is_partly_named_where_what_may_remain_leaves_its_name_unsure(p, expected):
    # A rest with a fifth of the gap's square has 45 % of its RMS: P(a) = 1 - 0.45 p
    finding = decided({"a": 1 - p, "a & rest": p})
    assert finding.verdict == expected and finding.remainder == pytest.approx(p)
    assert finding.share_left == pytest.approx(0.2 * p)


@pytest.mark.parametrize(("p", "expected"), [(0.3, "one of"), (0.02, "partly named")])
def test_a_rest_that_is_possible_is_none_where_the_name_is_unsure_for_another_reason(p, expected):
    # P(a) lacks p, for nothing may be missing at all, and 0.45 × 0.25 for a rest; with a fifth of its square.
    finding = decided({"a": 0.75 - p, "a & rest": 0.25, "no gap": p})
    assert finding.verdict == expected
    assert finding.remainder == pytest.approx(0.25 / (1 - p)) and finding.places[0].tied == ()


@pytest.mark.parametrize(
    ("share", "expected"),
    [
        (0.9 * NEGLIGIBLE, "named"),
        (1.1 * NEGLIGIBLE, "partly named"),
        (0.95 * SUBSTANTIAL, "partly named"),
        (1.01 * SUBSTANTIAL, "unknown"),
    ],
)
def test_the_share_that_remains_decides_how_far_an_effect_is_named(share, expected):
    finding = decided({"a & rest": 0.99, "a": 0.01}, share=share)
    assert finding.verdict == expected
    assert slugs(finding) == (() if expected == "unknown" else ("a",))


def test_a_rest_takes_its_share_from_the_probability_of_the_effect():
    found = decided({"a & rest": 0.99, "a": 0.01}, share=0.25).weighed
    assert found.by_effect["a"] == pytest.approx(0.01 + 0.99 * 0.5, abs=1e-6)
    assert found.by_kind["unknown"] == pytest.approx(0.99 * 0.5, abs=1e-6)


def test_what_is_next_to_impossible_leaves_nothing_but_for_a_process_in_time():
    table = {"a & rest": 0.9, "b": 1e-5, "no gap": 0.1}

    def left(**given):
        found = Weighed([world(table, **given)])
        return next(share for _, e, _, share in found.items if e.effects and not e.leaves_rest)

    assert left() == 0.0
    assert left(names=(PROCESS,)) == pytest.approx(0.2)


def test_two_effects_with_a_rest_that_one_carries_alone_make_way_for_it():
    table = {"ab & rest": 0.5, "a & rest": 0.4, "b & rest": 0.1}
    finding = decided(table, shares={"ab & rest": 0.26, "a & rest": 0.1, "b & rest": 0.9})
    assert slugs(finding) == ("a",) and finding.verdict == "partly named"


def test_an_effect_that_was_not_weighed_with_a_rest_takes_nobodys_place():
    finding = decided({"ab & rest": 0.99, "a": 0.01}, share=0.6)
    assert finding.verdict == "unknown"


def test_kinds_of_explanations_add_up_to_one():
    table = {"no gap": 0.1, "recalibrate": 0.1, "unknown": 0.1, "! offset": 0.1, "a": 0.2, "ab & rest": 0.3, "abc": 0.1}
    every = Weighed([world(table, on=dict.fromkeys("abc", "x"))])
    assert sum(every.by_kind.values()) == pytest.approx(1.0)
    # abc is one variable's: half of it is a law that has no name
    assert every.by_kind["effects"] == pytest.approx(0.2 + 0.3 * (1 - 0.2**0.5) + 0.1 * STACKED)


@pytest.mark.parametrize(("share", "expected"), [(0.1, "partly named"), (0.5, "unknown")])
def test_a_process_in_time_is_a_rest_too(share, expected):
    quiet = world({"unknown": 1e-9, "a": 1e-3})
    moving = world({"a": 0.9, "no gap": 0.1}, names=(PROCESS,), shares={"a": share})
    finding = decide([moving, quiet])
    assert finding.verdict == expected
    if expected == "unknown":
        assert finding.places == () and PROCESS in finding.world.model.names


def test_nothing_but_a_process_in_time_is_unknown():
    moving = world({"no gap": 0.9, "a": 0.1}, names=(PROCESS,))
    assert decide([moving, world({"unknown": 1e-9, "no gap": 1e-3})]).verdict == "unknown"


def test_a_world_counts_by_its_offset():
    white = world({"unknown": 1e-9, "a": 1.0})
    other = world({"unknown": 1e-9, "no gap": 1.0}, names=("correlated noise",), offset=np.log(3))
    finding = decide([other, white])
    assert finding.verdict == "no gap" and finding.world is other
    assert finding.weighed.by_noise == {"correlated noise": pytest.approx(0.75)}


# Several laws of one variable


@pytest.mark.parametrize(
    ("effects", "inner", "expected"), [("ab", "", "named"), ("ab", "b", "partly named"), ("abc", "", "partly named")]
)
def test_stacked_laws_of_one_variable_are_never_named(effects, inner, expected):
    finding = decided({effects: 1.0}, on=dict.fromkeys("abc", "x"), inner=inner)
    assert finding.verdict == expected


def test_what_may_be_one_law_is_added_unless_something_else_is_unknown():
    on = dict.fromkeys("abc", "x")
    assert len(decided({"abc": 0.6, "unknown": 0.4}, on=on).places) == 3
    # As much as that of which nothing is known counts against it, not the half that would look the same.
    assert decided({"abc": 0.4, "unknown": 0.6}, on=on).verdict == "unknown"


def test_what_may_be_one_law_does_not_speak_for_another_effect():
    table = {"a": 0.25, "bc": 0.23, "bd": 0.23, "unknown": 0.29}
    assert decided(table, on=dict.fromkeys("abcd", "x"), inner="b").verdict == "unknown"


def test_what_is_left_beside_what_may_be_one_law_is_told():
    finding = decided({"ab & rest": 1.0}, on=dict.fromkeys("ab", "x"), inner="b", share=0.1)
    assert finding.verdict == "partly named" and finding.against == (AND_MORE,)


def test_a_quantity_is_surer_than_the_names_of_its_laws():
    on = {"a": "x", "b": "x", "c": "x", "d": "y"}
    found = decided({"abc": 0.5, "ad": 0.3, "d": 0.2}, on=on).weighed.by_quantity
    assert found == {("x",): pytest.approx(0.8), ("y",): pytest.approx(0.5)}


def test_laws_of_one_variable_beside_another_cap_the_verdict():
    finding = decided({"abc": 1.0}, on={"a": "x", "b": "x", "c": "y"}, inner="b")
    assert finding.verdict == "partly named" and finding.against


def test_laws_of_different_variables_are_not_stacked():
    finding = decided({"abc": 1.0}, on={"a": "x", "b": "x", "c": "y"}, inner="c")
    assert finding.verdict == "named"


def test_an_effect_among_stacked_ones_is_half_as_probable():
    found = decided({"abcd": 1.0}, on={"a": "x", "b": "x", "c": "x", "d": "y"}).weighed
    assert found.by_effect["a"] == pytest.approx(1 - STACKED) and found.by_effect["d"] == pytest.approx(1.0)


# What speaks against it


@pytest.mark.parametrize("stop", ["no gap", "recalibrate", "unknown", "! offset"])
def test_what_speaks_against_a_stop_is_told_and_changes_nothing(stop):
    finding = decided({stop: 1.0})
    assert finding.capped(["hangs together"]).verdict == finding.verdict
    assert finding.capped(["hangs together"]).against == ("hangs together",)


@pytest.mark.parametrize(
    ("table", "before", "after"),
    [
        ({"a": 1.0}, "named", "partly named"),
        ({"a": 0.6, "b": 0.4}, "one of", "one of"),
        ({"a & rest": 1.0}, "partly named", "partly named"),
    ],
)
def test_checks_cap_a_name_and_never_raise_it(table, before, after):
    finding = decided(table)
    assert (finding.verdict, finding.capped(["once"]).verdict) == (before, after)
    assert finding.capped([]) is finding
    assert finding.capped(["once"]).capped(["twice"]).against == ("once", "twice")


def test_verdicts_are_in_the_order_of_what_they_ask_of_the_users_physics():
    assert VERDICTS == ("no gap", "instrument", "recalibrate", "named", "one of", "partly named", "unknown")


# Samples that contradict each other


BENT = Doubt(0.95, 0.1)


def doubted(table, doubt, **rms):
    found = world({"unknown": 1e-9} | table)
    found.__dict__["rms"] = rms
    return decide([found], [doubt])


def test_a_large_effect_stands_beside_a_small_contradiction():
    finding = doubted({"a": 0.999}, BENT, a=10.0)
    assert slugs(finding) == ("a",) and finding.weighed.by_effect["a"] == pytest.approx(0.999 * (1 - 0.0095), abs=1e-3)


def test_an_effect_no_larger_than_what_the_contradiction_does_is_unknown():
    finding = doubted({"a": 0.999, "no gap": 0.001}, BENT, a=0.08)
    assert finding.verdict == "unknown" and finding.places == ()
    assert finding.weighed.by_effect["a"] == pytest.approx(0.05, abs=1e-3)
    assert finding.weighed.by_kind["unknown"] == pytest.approx(0.95, abs=1e-2)


def test_of_two_effects_the_small_one_goes():
    finding = doubted({"ab": 0.99, "a": 0.01}, BENT, a=10.0, b=0.1)
    assert finding.verdict == "partly named" and slugs(finding) == ("a",)
    assert finding.weighed.by_effect["b"] < 0.1 < SURE < finding.weighed.by_effect["a"]


def test_kinds_add_up_to_one_whatever_is_doubted():
    for kind in ("", "no gap", "recalibrate", "effects"):
        finding = doubted({"ab": 0.4, "no gap": 0.3, "recalibrate": 0.2, "b & rest": 0.1}, Doubt(0.7, 0.3, kind), b=0.5)
        assert sum(finding.weighed.by_kind.values()) == pytest.approx(1.0)


@pytest.mark.parametrize("stop", ["no gap", "recalibrate", "! offset"])
def test_an_answer_without_effects_that_its_own_state_denies_is_unknown_in_the_tables_too(stop):
    kind = "instrument" if stop.startswith("!") else stop
    finding = doubted({stop: 1.0}, Doubt(0.9, 1e-6, kind))
    assert finding.verdict == "unknown" and finding.weighed.by_kind["unknown"] == pytest.approx(0.9)
    assert finding.weighed.by_suspect.get("offset", 0.0) == pytest.approx(0.1 if kind == "instrument" else 0.0)
    assert doubted({stop: 1.0}, Doubt(0.9, 1e-6)).verdict != "unknown"


def test_an_answer_that_its_own_state_denies_makes_way_for_one_that_it_does_not():
    table = {"! offset": 0.5, "recalibrate": 0.45, "a": 0.05}
    assert doubted(table, Doubt(0.01, 0.1), a=1.0).verdict == "instrument"
    finding = doubted(table, Doubt(1.0, 0.1, "instrument"), a=1.0)
    assert finding.verdict == finding.kind == "recalibrate" and finding.weighed.by_kind["recalibrate"] > 0.85
    assert finding.weighed.by_suspect["offset"] == 0.0
    # Of answers without effects; those with effects are no likelier for it.
    assert finding.weighed.by_kind["effects"] <= 0.05


def test_what_no_answer_without_effects_explains_speaks_for_effects_and_not_against():
    table = {"no gap": 0.4, "recalibrate": 0.15, "a": 0.45}
    denials = [Doubt(1.0, 1.0, kind) for kind in ("no gap", "recalibrate")]
    weighed = decide([world({"unknown": 1e-9} | table)], denials).weighed
    assert weighed.by_effect["a"] == pytest.approx(0.45) and weighed.by_kind["unknown"] == pytest.approx(0.55)
    assert doubted(table, Doubt(1.0, 1.0, "effects"), a=1.0).weighed.by_effect["a"] == pytest.approx(0.0)
