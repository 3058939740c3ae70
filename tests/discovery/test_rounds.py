"""The rules of the rounds, one by one, on rounds whose probabilities are written down by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayes_greybox.discovery.hypotheses import Contest, Explanation, Round
from bayes_greybox.discovery.rounds import NEGLIGIBLE, SAME, STOPS, SUBSTANTIAL, TIED, search

SLUGS = "abcdef"
"""An effect is a letter, and its column the letter's place."""


def hand_made(base, probabilities, share, evidence):
    """A round over columns `base` with these probabilities; log evidences are log probabilities unless given."""
    explanations = []
    for name, p in ({"unknown": 1e-12} | probabilities).items():
        index = None if name in STOPS else SLUGS.index(name)
        explanations.append(
            Explanation(
                name,
                () if index is None else (index,),
                log_weight=float(np.log(p)),
                log_evidence=float(evidence.get(name, np.log(p))),
                best=index,
                share_left=share if name == "unknown" else share / 2,
            )
        )
    return Round(tuple(base), tuple(explanations))


class Written(Contest):
    """A contest whose rounds are read off a table {"ab": probabilities given the effects a and b}."""

    def __init__(self, rounds, share=0.0, evidence=None):
        self.rounds, self.share, self.evidence = rounds, share, evidence or {}
        self.weighed, self.settled = [], []
        self.evaluations = SimpleNamespace(name=lambda index: SLUGS[index])

    def round(self, base=()):
        key = "".join(sorted(SLUGS[i] for i in base))
        self.weighed.append(key)
        return hand_made(base, self.rounds[key], self.share, self.evidence.get(key, {}))

    def settle(self, base, seed):
        found = self.round(base)
        self.settled.append((self.weighed.pop(), seed))
        return found


def added(finding):
    return "".join(SLUGS[i] for i in finding.base)


def one_effect(enough=0.9, unknown=0.05, b=0.05):
    """The effect a is found; what is left is enough, unknown or b."""
    return {"": {"no gap": 0.05, "a": 0.9, "b": 0.05}, "a": {"enough": enough, "unknown": unknown, "b": b}}


def two_effects(**given):
    """The effects a and b are found, and each is wanted beside the other; `given` replaces rounds."""
    return {
        "": {"no gap": 0.01, "a": 0.9, "b": 0.09},
        "a": {"enough": 0.1, "b": 0.8, "c": 0.1},
        "b": {"enough": 0.1, "a": 0.7, "c": 0.2},
        "ab": {"enough": 0.9, "c": 0.1},
        **given,
    }


# Forward


@pytest.mark.parametrize(("p", "expected"), [(0.51, "a"), (0.49, "")])
def test_an_effect_is_added_if_it_is_likelier_than_the_best_stop(p, expected):
    contest = Written({"": {"no gap": 1 - p, "a": p}, "a": {"enough": 1.0}})
    assert added(search(contest, 3)) == expected


def test_stops_are_not_added_up_against_an_effect():
    first = {"no gap": 0.3, "recalibrate": 0.2, "unknown": 0.1, "a": 0.4}
    assert added(search(Written({"": first, "a": {"enough": 1.0}}), 3)) == "a"


def test_different_effects_are_not_added_up_against_a_stop():
    first = {"no gap": 0.4, "a": 0.35, "b": 0.25}
    assert added(search(Written({"": first}), 3)) == ""


@pytest.mark.parametrize(("apart", "expected"), [(0.0, "a"), (0.9 * SAME, "a"), (1.1 * SAME, "")])
def test_names_of_one_effect_do_not_split_its_vote(apart, expected):
    rounds = {"": {"no gap": 0.4, "a": 0.301, "b": 0.299}, "a": {"enough": 0.9, "b": 0.1}}
    contest = Written(rounds, evidence={"": {"a": 5.0, "b": 5.0 - apart}})
    assert added(search(contest, 3)) == expected


def test_only_the_twins_of_the_likeliest_effect_vote_with_it():
    first = {"no gap": 0.4, "a": 0.22, "b": 0.19, "c": 0.19}
    contest = Written({"": first}, evidence={"": {"a": 5.0, "b": 4.0, "c": 4.0}})
    assert added(search(contest, 3)) == ""


def test_effects_are_added_until_none_is_wanted():
    rounds = two_effects(ab={"enough": 0.2, "c": 0.8}, abc={"enough": 1.0})
    rounds |= {"ac": {"enough": 0.1, "b": 0.9}, "bc": {"enough": 0.1, "a": 0.9}}
    assert added(search(Written(rounds), 5)) == "abc"


@pytest.mark.parametrize(("most", "expected"), [(0, ""), (1, "a"), (2, "ab")])
def test_there_are_never_more_effects_than_allowed(most, expected):
    rounds = two_effects(ab={"enough": 0.2, "c": 0.8}, abc={"enough": 1.0})
    assert added(search(Written(rounds), most)) == expected


def test_a_catalogue_that_is_used_up_ends_the_rounds():
    contest = Written({"": {"no gap": 0.1, "a": 0.9}, "a": {"enough": 1.0}})
    finding = search(contest, 3)
    assert added(finding) == "a" and len(finding.steps) == 2


def test_an_empty_catalogue_leaves_the_stops():
    finding = search(Written({"": {"no gap": 0.2, "recalibrate": 0.8}}), 3)
    assert finding.verdict == "recalibrate" and len(finding.steps) == 1


# The ladder


def test_the_ladder_has_a_step_for_each_round_and_says_what_was_added():
    finding = search(Written(two_effects()), 3)
    assert [step.added for step in finding.steps] == ["a", "b", ""]


def test_the_ladder_has_the_probabilities_of_each_round_largest_first():
    finding = search(Written(two_effects()), 3)
    assert [next(iter(step.probabilities)) for step in finding.steps] == ["a", "b", "enough"]
    assert finding.steps[1].probabilities["b"] == pytest.approx(0.8)


def test_the_ladder_has_the_share_left_by_the_likeliest_explanation():
    first, second = search(Written(one_effect(enough=0.2, unknown=0.8, b=1e-6), share=0.2), 3).steps
    # By the table, an effect leaves half of what f alone carries.
    assert first.share_left == pytest.approx(0.1)
    assert second.share_left == pytest.approx(0.2)


def test_a_step_that_the_allowed_number_forbids_adds_nothing():
    finding = search(Written(two_effects()), 1)
    assert [step.added for step in finding.steps] == ["a", ""]


def test_first_and_last_are_the_rounds_without_and_with_all_effects():
    finding = search(Written(two_effects()), 3)
    assert finding.first.base == () and finding.last.base == (0, 1)


# Probability and ties


def test_the_probability_of_one_effect_is_that_of_the_first_round():
    assert search(Written(one_effect()), 3).probability == pytest.approx((0.9,))


def test_the_probability_of_an_effect_is_given_the_others():
    assert search(Written(two_effects()), 3).probability == pytest.approx((0.7, 0.8))


@pytest.mark.parametrize(("factor", "expected"), [(1.01, ("b",)), (0.99, ())])
def test_effects_are_tied_from_a_share_of_the_added_ones_probability(factor, expected):
    rounds = one_effect()
    rounds[""] = {"no gap": 0.05, "a": 0.8, "b": factor * TIED * 0.8}
    assert search(Written(rounds), 3).ties == (expected,)


def test_what_is_no_effect_is_never_tied():
    rounds = one_effect()
    rounds[""] = {"no gap": 0.3, "recalibrate": 0.2, "unknown": 0.1, "a": 0.4}
    assert search(Written(rounds), 3).ties == ((),)


def test_each_effect_is_tied_with_what_could_stand_for_it_beside_the_others():
    rounds = two_effects(a={"enough": 0.1, "b": 0.8, "c": 0.1}, b={"enough": 0.1, "a": 0.7, "d": 0.2})
    assert search(Written(rounds), 3).ties == (("d",), ("c",))


# Verdicts


@pytest.mark.parametrize("stop", ["no gap", "recalibrate", "unknown"])
def test_without_effects_the_verdict_is_the_likeliest_stop(stop):
    first = {"no gap": 0.1, "recalibrate": 0.1, "unknown": 0.1} | {stop: 0.5} | {"a": 0.3}
    finding = search(Written({"": first}), 3)
    assert finding.verdict == stop and finding.base == () and finding.probability == () and finding.ties == ()


def test_without_room_for_an_effect_the_verdict_is_a_stop_all_the_same():
    assert search(Written({"": {"no gap": 0.01, "unknown": 0.04, "a": 0.95}}), 0).verdict == "unknown"


def test_without_effects_what_remains_is_the_probability_of_the_unknown():
    finding = search(Written({"": {"no gap": 0.5, "unknown": 0.2, "a": 0.3}}, share=0.7), 3)
    assert finding.remainder == pytest.approx(0.2) and finding.share_left == pytest.approx(0.7)


def test_what_remains_is_weighed_against_enough_alone():
    finding = search(Written(one_effect(enough=0.6, unknown=0.2, b=0.2)), 3)
    assert finding.remainder == pytest.approx(0.2 / 0.8)


@pytest.mark.parametrize(("b", "expected"), [(0.49, 0.0), (0.51, 1.0)])
def test_where_other_effects_are_likelier_than_not_something_remains(b, expected):
    contest = Written(one_effect(enough=1 - b, unknown=1e-12, b=b))
    assert search(contest, 1).remainder == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("unknown", "expected"), [(0.49, "named"), (0.51, "partly named")])
def test_an_effect_is_named_if_more_likely_than_not_nothing_remains(unknown, expected):
    contest = Written(one_effect(enough=1 - unknown, unknown=unknown, b=1e-9), share=0.2)
    assert search(contest, 3).verdict == expected


def test_an_effect_is_named_whatever_share_f_would_carry_if_f_does_not_remain():
    assert search(Written(one_effect(enough=0.9, unknown=0.1, b=1e-9), share=0.8), 3).verdict == "named"


@pytest.mark.parametrize(
    ("share", "expected"),
    [
        (0.99 * NEGLIGIBLE, "named"),
        (1.01 * NEGLIGIBLE, "partly named"),
        (0.99 * SUBSTANTIAL, "partly named"),
        (1.01 * SUBSTANTIAL, "unknown"),
    ],
)
def test_where_f_remains_its_share_decides_how_far_an_effect_is_named(share, expected):
    assert search(Written(one_effect(enough=0.1, unknown=0.9, b=1e-9), share=share), 3).verdict == expected


@pytest.mark.parametrize(("share", "expected"), [(0.99 * NEGLIGIBLE, "named"), (1.01 * NEGLIGIBLE, "unknown")])
def test_two_effects_that_leave_a_rest_are_never_partly_named(share, expected):
    contest = Written(two_effects(ab={"enough": 0.1, "unknown": 0.9}), share=share)
    assert search(contest, 3).verdict == expected


def test_an_unknown_rest_leaves_no_effect_in_the_model():
    finding = search(Written(one_effect(enough=0.1, unknown=0.9, b=1e-9), share=0.5), 3)
    assert finding.verdict == "unknown"
    assert finding.base == () and finding.probability == () and finding.ties == ()


def test_the_ladder_still_shows_the_effect_that_an_unknown_rest_threw_out():
    finding = search(Written(one_effect(enough=0.1, unknown=0.9, b=1e-9), share=0.5), 3)
    assert finding.steps[0].added == "a" and finding.last.base == (0,)
    assert finding.remainder == pytest.approx(0.9) and finding.share_left == pytest.approx(0.5)


# The backward check


def test_two_effects_that_are_wanted_beside_each_other_stay_in_the_order_in_which_they_came():
    assert added(search(Written(two_effects()), 3)) == "ab"


def test_an_effect_that_another_explains_better_is_replaced_in_its_place():
    rounds = two_effects(b={"enough": 0.05, "a": 0.05, "c": 0.9})
    rounds |= {"bc": {"enough": 0.9, "a": 0.1}, "c": {"enough": 0.1, "b": 0.9}}
    finding = search(Written(rounds), 3)
    assert added(finding) == "cb"
    assert finding.probability == pytest.approx((0.9, 0.9))
    assert finding.last.base == (2, 1)


def test_an_effect_that_nothing_needs_is_dropped():
    rounds = two_effects(b={"enough": 0.9, "a": 0.1})
    rounds[""] = {"no gap": 0.01, "a": 0.6, "b": 0.39}
    finding = search(Written(rounds), 3)
    assert added(finding) == "b"
    assert finding.probability == pytest.approx((0.39,))
    assert finding.last.base == (1,)


def test_the_ladder_does_not_tell_of_the_backward_check():
    finding = search(Written(two_effects(b={"enough": 0.9, "a": 0.1})), 3)
    assert [step.added for step in finding.steps] == ["a", "b", ""]


def test_the_unknown_alone_drops_no_effect():
    assert added(search(Written(two_effects(b={"enough": 0.05, "unknown": 0.9, "a": 0.05})), 3)) == "ab"


def test_an_effect_gives_way_to_a_likelier_one_even_where_the_unknown_is_likelier_than_both():
    rounds = two_effects(b={"enough": 0.01, "unknown": 0.9, "a": 0.03, "c": 0.06})
    rounds |= {"bc": {"enough": 0.9, "a": 0.1}, "c": {"enough": 0.1, "b": 0.9}}
    assert added(search(Written(rounds), 3)) == "cb"


@pytest.mark.parametrize(("enough", "expected"), [(0.3, "ab"), (0.5, "b")])
def test_an_effect_that_is_the_likeliest_stays_unless_enough_is_likelier_still(enough, expected):
    rounds = two_effects(b={"enough": enough, "a": 0.4, "c": 0.6 - enough})
    rounds[""] = {"no gap": 0.01, "a": 0.6, "b": 0.39}
    assert added(search(Written(rounds), 3)) == expected


@pytest.mark.parametrize(("apart", "expected"), [(0.9 * SAME, "ab"), (1.1 * SAME, "b")])
def test_a_twin_votes_for_the_effect_in_the_backward_check_too(apart, expected):
    rounds = two_effects(b={"enough": 0.4, "a": 0.301, "c": 0.299})
    contest = Written(rounds, evidence={"b": {"a": 5.0, "c": 5.0 - apart}})
    assert added(search(contest, 3)) == expected


def test_a_replacement_sends_the_check_round_once_more():
    # b is wanted beside a, but not beside c, which took the place of a; d is.
    rounds = two_effects(b={"enough": 0.05, "c": 0.9, "a": 0.05}, c={"enough": 0.1, "d": 0.8, "b": 0.1})
    rounds |= {"d": {"enough": 0.1, "c": 0.9}, "cd": {"enough": 1.0}}
    contest = Written(rounds)
    assert added(search(contest, 3)) == "cd"
    # First sweep beside b and c, second beside d and c.
    start = contest.weighed.index("b")
    assert contest.weighed[start : start + 4] == ["b", "c", "d", "c"]


def test_the_check_sweeps_at_most_twice():
    # Beside b stands c, beside c stands d, beside d stands a, beside a stands b: it would never end.
    wanted = {"b": "c", "c": "d", "d": "a"}
    rounds = two_effects(**{beside: {"enough": 0.1, best: 0.9} for beside, best in wanted.items()})
    # One sweep would end with c and d, and so would three.
    assert added(search(Written(rounds), 3)) == "ab"


def test_after_a_drop_the_others_are_not_checked_again():
    rounds = two_effects(b={"enough": 0.9, "a": 0.1})
    rounds[""] = {"no gap": 0.0994, "a": 0.9, "b": 0.0006}
    finding = search(Written(rounds), 3)
    # Even where the first round thinks nothing of what is left.
    assert added(finding) == "b" and finding.probability == pytest.approx((0.0006,))


def test_one_effect_alone_is_not_checked():
    contest = Written(one_effect())
    search(contest, 3)
    assert contest.weighed == ["", "a"]


# Chains, and what is told


def test_without_a_seed_no_chains_are_run():
    contest = Written(two_effects())
    search(contest, 3)
    assert contest.settled == []


def test_with_a_seed_every_forward_round_is_settled_by_chains_of_that_seed():
    contest = Written(two_effects())
    search(contest, 3, seed=7)
    assert contest.settled == [("", 7), ("a", 7), ("ab", 7)]


def test_the_round_after_a_change_by_the_check_is_settled_too():
    rounds = two_effects(b={"enough": 0.9, "a": 0.1})
    contest = Written(rounds)
    search(contest, 3, seed=7)
    assert contest.settled[-1] == ("b", 7)


def test_what_is_being_done_is_told_in_words():
    told = []
    search(Written(one_effect()), 3, report=told.append)
    assert told == ["weighing explanations", "added a, weighing what is left"]
