"""Probabilities and verdicts of hypotheses that are written down by hand."""

import numpy as np
import pytest

from bayes_greybox.discovery.decision.criteria import Criteria
from bayes_greybox.discovery.decision.decide import AND_MORE_IN_WORDS, ONE_LAW_IN_WORDS, VERDICTS, decide
from bayes_greybox.discovery.decision.probabilities import EFFECTS, Probabilities, Share, trusted
from bayes_greybox.discovery.decision.reasons import Reason
from bayes_greybox.discovery.grid.latent_force import ForcedRates
from bayes_greybox.discovery.grid.log_evidence import Gram
from bayes_greybox.discovery.grid.points import (
    DISCREPANCIES,
    LATENT_FORCE,
    LAW,
    NO_DISCREPANCY,
    SENSOR_NOISE,
    NoisePoint,
)
from bayes_greybox.discovery.grid.sets import SetPrior
from bayes_greybox.discovery.grid.table import CORRECTION, EFFECT, FREE, Features, Regressor, RegressorTable
from bayes_greybox.discovery.grid.weigh import Hypothesis, Weighed
from bayes_greybox.discovery.odds import Odds

N = 4
POINTS = (
    NoisePoint(NO_DISCREPANCY),
    NoisePoint(SENSOR_NOISE, 1.0, 0.1),
    NoisePoint(LATENT_FORCE, 1.0, 1.0),
    NoisePoint(LAW, 1.0, 1.0),
)
NAMES = {
    "free": Regressor(FREE, "free:x", "x", 10.0),
    "k": Regressor(CORRECTION, "correction:k", "k", 0.3),
    "cube": Regressor(EFFECT, "cube(r=y)", "cube", 1.0, ("y",)),
    "cube v": Regressor(EFFECT, "cube(r=v)", "cube", 1.0, ("v",)),
    "fifth": Regressor(EFFECT, "fifth(r=y)", "fifth", 1.0, ("y",)),
    "zone": Regressor(EFFECT, "zone(r=y)", "zone", 1.0, ("y",), bends=True),
    "dry": Regressor(EFFECT, "dry(r=v)", "dry", 1.0, ("v",)),
    "force": Regressor(EFFECT, "force()", "force", 1.0, ()),
    "offset": Regressor("suspect", "suspect:offset of a", "offset of a", 0.1),
    "delay": Regressor("suspect", "suspect:delay of F", "delay of F", 0.1),
}
ORDER = list(NAMES)
OWN = 1.0
"""Size of what each regressor contributes, over that of the gap."""


def weighed(*given):
    """Hypotheses by "cube + offset": probability, and of what remains: a kind, its probability, and its RMS.

    The agreement is the probability, or what comes last.
    """
    found = []
    for names, p, *rest in given:
        kind, share, left = rest[0] if rest and rest[0] else (NO_DISCREPANCY, 1.0, 0.0)
        agreement = rest[1] if len(rest) > 1 else p
        members = tuple(sorted(ORDER.index(name) for name in names.split(" + ") if name))
        kinds = dict.fromkeys(DISCREPANCIES, 0.0) | {NO_DISCREPANCY: 1 - share}
        kinds[kind] += share
        k, beside = len(members), left * float(np.sqrt(share if kind != NO_DISCREPANCY else 0.0))
        points = np.array([kinds[point.kind] for point in POINTS])
        found.append(
            Hypothesis(
                members, float(np.log(max(p, 1e-300))), p, agreement, kinds, {}, points, int(np.argmax(points)), 0.1,
                np.full(k, OWN), 0.01 * np.eye(k), np.full(k, OWN), beside, np.full(k, beside), np.zeros(k),
            )
        )  # fmt: skip
    found.sort(key=lambda h: -h.probability)
    nothing = Features(np.zeros((N, 0)), np.zeros((N, 0)))
    force = ForcedRates(np.arange(4.0), np.zeros(N), 1.0, np.ones(N), 0.1)
    table = RegressorTable(
        tuple(NAMES.values()), np.ones(N), *(np.zeros((N, len(NAMES))),) * 2, force, np.zeros(N, int), nothing,
        np.zeros((0, 1)),
    )  # fmt: skip
    gram = Gram(POINTS, np.zeros((4, 1, 1)), np.zeros(4), float(N))
    prior = SetPrior.of(table.regressors, Odds(), 3)
    return Weighed(table, (force,), gram, np.ones(len(NAMES)), 1e-8, tuple(found), np.zeros((len(found), 1)), prior)


def probabilities(*given, **criteria):
    return Probabilities(weighed(*given), Criteria(**criteria))


def verdict(*given, rate_size=1.0, put_right=False):
    return decide(probabilities(*given), rate_size, put_right)


# What an effect may imitate


@pytest.mark.parametrize(("own", "left", "p"), [(1.0, 0.0, 1.0), (1.0, 1.0, 0.5), (1.0, 3.0, 0.1), (0.0, 0.0, 0.0)])
def test_an_effect_counts_by_its_size_beside_what_is_left(own, left, p):
    assert trusted(own, left) == pytest.approx(p)


def test_an_effect_that_what_is_left_cancels_is_nothing():
    # The contribution a and w with a + w = 0.8 a closes 1 − left²/(0.8 own)² of itself and w together.
    assert trusted(1.0, 0.2, -0.2) == pytest.approx(1 - 0.2**2 / 0.8**2)
    assert trusted(1.0, 1.0, -1.0) == 0.0
    assert trusted(1.0, 0.5, 0.1) > trusted(1.0, 0.5)


def test_what_is_no_larger_than_what_is_left_goes_to_the_unknown():
    p = probabilities(("cube", 0.8, (LAW, 1.0, 1.0)), ("", 0.2))
    assert p.by_effect["cube"] == pytest.approx((0.4, 0.4))
    assert p.by_kind == pytest.approx(
        {"no gap": 0.2, "recalibrate": 0.0, "instrument": 0.0, "unknown": 0.4, "effects": 0.4}
    )


def test_kinds_add_up_to_one_and_noise_of_a_sensor_leaves_nothing_of_the_system():
    p = probabilities(
        ("", 0.1), ("k", 0.2, (LATENT_FORCE, 0.5, 0.3)), ("offset", 0.1, (SENSOR_NOISE, 1.0, 0.5)), ("cube + k", 0.3),
        ("dry", 0.3, (LAW, 0.4, 0.8)),
    )  # fmt: skip
    assert sum(p.by_kind.values()) == pytest.approx(1.0)
    assert p.by_kind["instrument"] == pytest.approx(0.1) and p.by_kind["recalibrate"] == pytest.approx(0.1)
    assert p.by_discrepancy[SENSOR_NOISE] == pytest.approx(0.1) and p.by_discrepancy[LATENT_FORCE] == pytest.approx(0.1)


def test_shares_of_corrections_and_sensor_errors_are_said_whatever_else_is():
    p = probabilities(("cube + k + offset", 0.7), ("cube + k", 0.2), ("", 0.1))
    assert p.by_correction["k"].probability == pytest.approx(0.9)
    assert p.by_sensor["offset of a"].probability == pytest.approx(0.7)
    assert list(p.by_sensor) == ["offset of a", "delay of F"]


def test_an_effect_has_the_sum_of_its_places_and_a_quantity_that_of_its_laws():
    p = probabilities(("cube", 0.4, None, 0.3), ("cube v", 0.3), ("fifth", 0.2), ("", 0.1))
    assert p.by_effect["cube"] == pytest.approx((0.7, 0.6))
    assert p.by_place["cube(r=y)"].probability == pytest.approx(0.4)
    assert p.by_quantity["y"].probability == pytest.approx(0.6)
    assert list(p.by_effect)[:2] == ["cube", "fifth"]


def test_both_places_of_one_effect_in_one_hypothesis_count_once():
    assert probabilities(("cube + cube v", 0.6), ("", 0.4)).by_effect["cube"].probability == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("names", "factor"), [("cube + fifth", 1.0), ("cube + zone", 0.5), ("cube + fifth + zone", 0.5), ("zone + dry", 1)]
)
def test_three_effects_of_one_quantity_or_two_of_which_one_bends_may_be_one_law(names, factor):
    p = probabilities((names, 0.8), ("", 0.2))
    assert p.by_effect["zone" if "zone" in names else "cube"].probability == pytest.approx(0.8 * factor)


# Verdicts


def codes():
    return {
        "no gap": [("", 0.9), ("cube", 0.1)],
        "recalibrate": [("k", 0.9), ("", 0.1)],
        "instrument": [("offset", 0.9), ("", 0.1)],
        "named": [("cube", 0.97), ("", 0.03)],
        "one of": [("cube", 0.6), ("fifth", 0.4)],
        "partly named": [("cube", 0.97, (LAW, 0.9, 0.2)), ("", 0.03)],
        "unknown": [("", 0.9, (LAW, 1.0, 0.9)), ("cube", 0.1)],
    }


@pytest.mark.parametrize("code", VERDICTS)
def test_each_verdict(code):
    found = verdict(*codes()[code])
    assert found.code == code and not found.reasons
    assert [place.slug for place in found.places] == (["cube"] if "name" in code or code == "one of" else [])
    assert found.open_ended == (code in ("partly named", "unknown"))


@pytest.mark.parametrize(
    ("p", "agreement", "code"), [(0.91, 0.91, "named"), (0.91, 0.8, "one of"), (0.85, 0.95, "one of")]
)
def test_a_name_needs_probability_and_agreement(p, agreement, code):
    assert verdict(("cube", p, None, agreement), ("", 1 - p)).code == code


def test_what_could_stand_in_an_effects_place_is_tied_from_a_twentieth_of_its_probability():
    found = verdict(("cube", 0.6), ("fifth", 0.2), ("dry", 0.1), ("zone", 0.02), ("", 0.08))
    (place,) = found.places
    assert place.tied == ("fifth", "dry")
    # The zone has a thirtieth.
    assert "zone" not in place.tied


def test_no_runner_up_is_likelier_than_the_answer():
    found = verdict(("cube", 0.35), ("fifth", 0.3), ("fifth + dry", 0.2), ("", 0.15))
    (place,) = found.places
    assert place.slug == "fifth" and place.share.probability == pytest.approx(0.5) and place.tied == ("cube",)


def test_the_same_effect_on_other_columns_is_called_by_them():
    (place,) = verdict(("cube", 0.6), ("cube v", 0.4)).places
    assert place.label == "cube(r=y)" and place.tied == ("cube(r=v)",)


def test_a_sensors_error_may_stand_in_an_effects_place():
    (place,) = verdict(("force", 0.6), ("offset", 0.4)).places
    assert place.tied == ("offset of a",)
    # Not one that is beside the effect as well: it is no alternative.
    (place,) = verdict(("force + offset", 0.6), ("offset", 0.4)).places
    assert place.tied == ()


def test_of_two_effects_each_has_what_could_stand_beside_the_other():
    found = verdict(("cube + dry", 0.6), ("fifth + dry", 0.35), ("dry", 0.05))
    tied = {place.slug: place.tied for place in found.places}
    assert tied == {"cube": ("fifth",), "dry": ()} and found.code == "one of"
    assert [place.slug for place in found.places] == ["dry", "cube"]


def test_effects_that_may_be_one_law_name_no_more_than_a_part_and_say_why():
    others = ("fifth", 0.25), ("dry", 0.1), ("", 0.05, (LAW, 1.0, 0.9))
    found = verdict(("cube + zone", 0.6), *others)
    assert found.code == "partly named" and found.reasons == (Reason("one law", ONE_LAW_IN_WORDS),)
    more = verdict(("cube + zone", 0.6, (LAW, 0.9, 0.3)), *others)
    assert more.code == "unknown" or more.reasons == (Reason("one law and more", AND_MORE_IN_WORDS),)


def test_effects_that_may_be_one_law_and_have_no_rival_are_a_law_without_a_name():
    found = verdict(("cube + zone", 0.98), ("", 0.02, (LAW, 1.0, 0.9)))
    assert found.code == "unknown" and found.places == () and found.open_ended
    assert found.probabilities.by_quantity["y"].probability == pytest.approx(0.98)


@pytest.mark.parametrize(("p", "code"), [(0.6, "partly named"), (0.5, "unknown")])
def test_beside_what_remains_an_effect_has_a_name_where_it_is_likelier_than_not(p, code):
    found = verdict(
        ("cube", p, (LATENT_FORCE, 0.8, 0.2)), ("fifth", 1 - p, (LATENT_FORCE, 0.8, 0.2)), ("", 0.0, (LAW, 1.0, 0.9))
    )
    assert found.code == code and (code == "unknown" or found.remains == pytest.approx(0.8))


def test_sensor_errors_of_an_answer_are_likelier_than_not():
    found = verdict(("cube + offset", 0.6), ("cube", 0.3), ("cube + delay", 0.1))
    assert found.sensors == ("offset of a",)
    assert verdict(("offset + delay", 0.6), ("offset", 0.4)).sensors == ("offset of a", "delay of F")


def test_a_late_sensor_that_was_put_right_before_is_the_instruments():
    assert verdict(*codes()["no gap"], put_right=True).code == "instrument"
    assert verdict(*codes()["recalibrate"], put_right=True).code == "recalibrate"


@pytest.mark.parametrize(
    ("beside", "code"), [("", "no gap"), ("k", "recalibrate"), ("offset", "instrument"), ("k + offset", "recalibrate")]
)
def test_beside_what_is_too_small_to_matter_a_wrong_sensor_is_said(beside, code):
    assert verdict((beside, 1.0, (LATENT_FORCE, 1.0, 0.009)), rate_size=1.0).code == code


# What is negligible


@pytest.mark.parametrize(("rate_size", "code"), [(1.0, "unknown"), (200.0, "no gap")])
def test_what_is_less_than_a_percent_of_the_modelled_rate_is_none(rate_size, code):
    found = verdict(("", 1.0, (LATENT_FORCE, 1.0, 0.9)), rate_size=rate_size)
    assert (found.code, found.negligible) == (code, code == "no gap") and found.left == pytest.approx(0.9)


def test_a_correction_beside_what_is_negligible_is_a_recalibration():
    found = verdict(("k", 0.9, (LATENT_FORCE, 1.0, 0.5)), ("", 0.1, (LATENT_FORCE, 1.0, 0.9)), rate_size=200.0)
    assert found.code == "recalibrate" and found.negligible
    assert found.hypothesis.members == (ORDER.index("k"),)


def test_an_effect_that_is_sure_is_not_neglected_with_the_rest():
    assert verdict(("cube", 0.97), ("", 0.03), rate_size=200.0).code == "named"


# Beside the verdict


def test_nothing_is_named_against_its_own_checks():
    found = verdict(*codes()["named"]).against([Reason("check", "residuals hang together")])
    assert found.code == "partly named" and found.reasons == (Reason("check", "residuals hang together"),)
    assert verdict(*codes()["no gap"]).against([Reason("check", "x")]).code == "no gap"
    plain = verdict(*codes()["named"])
    assert plain.against([]) is plain


def test_the_hypothesis_of_an_answer_is_its_likeliest():
    found = verdict(("cube + k", 0.3), ("cube", 0.4), ("cube + offset", 0.3))
    assert found.hypothesis.members == (ORDER.index("cube"),)
    assert verdict(("k", 0.4), ("", 0.6, (LAW, 0.2, 0.5))).hypothesis.members == ()


def test_what_ties_but_for_rounding_stays_in_the_catalogues_order():
    for rounding in (-1e-12, 1e-12):
        p = probabilities(("cube", 0.4), ("fifth", 0.4 * (1 + rounding)), ("", 0.2))
        assert list(p.by_effect)[:2] == ["cube", "fifth"]
    assert Share().plus(weighed(("", 0.5, None, 0.25)).hypotheses[0], 0.5) == (0.25, 0.125)
    assert EFFECTS not in VERDICTS
