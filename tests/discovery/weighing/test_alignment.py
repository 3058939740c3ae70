"""Delays found and undone, noisy and clipped samples, along a motion that is known at all times."""

from dataclasses import replace

import numpy as np
import pytest
from tiny_equation import CUBE, SQUARE, forced, forced_model, forced_study, on, soft, studied_motion

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.discovery.suspects.channels import DELAY_STEPS
from bayes_greybox.discovery.weighing.alignment import FURTHEST_DELAY, MOVED, align

CHANNELS = ("d(v)/dt", "states", "F")
STEP = 0.1


def aligned(data, most=2, **model):
    return align(forced_model(**model), data, "v", [on(CUBE, "y"), on(SQUARE, "y")], Odds(), most)


def found_delay(study, channel):
    """Its mean and standard deviation in steps, what was undone and what is left."""
    statistics, drawn = study.statistics, study.coefficients
    (place,) = (k for k, i in enumerate(drawn.suspects) if statistics.columns[i].suspect.key == f"delay of {channel}")
    column = statistics.columns[drawn.suspects[place]]
    left = drawn.suspect_draws[:, place] * statistics.target_scale / column.scale
    return (study.aligned.delays[channel] + left.mean()) / STEP, left.std() / STEP


# Delays


@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize("channel", CHANNELS)
def test_half_a_step_of_delay_is_found_and_undone(channel, missing):
    study = forced_study(missing, channel)
    assert set(study.aligned.delays) == {channel} and study.aligned.probability[channel] > 0.5
    mean, sd = found_delay(study, channel)
    # Four posterior standard deviations.
    assert abs(mean - 0.5) < 4 * sd < 0.1
    assert study.finding.verdict == ("named" if missing else "instrument")
    assert [place.slug for place in study.finding.places] == (["cube"] if missing else [])


def test_a_channel_that_is_early_has_a_negative_delay():
    study = forced_study(False, "d(v)/dt", -1.0)
    mean, sd = found_delay(study, "d(v)/dt")
    assert abs(mean + 1.0) < 4 * sd < 0.1


def test_states_and_inputs_stand_at_the_times_of_the_rate_once_a_delay_is_undone():
    late, exact = forced(soft, late={"F": 0.5}), forced(soft)
    found = aligned(late)
    inside = slice(2, -2)
    # A cubic spline between samples, and the delay's own error.
    assert found.data.n_obs == exact.n_obs - 1
    np.testing.assert_allclose(found.data.inputs["F"][inside], exact.inputs["F"][:-1][inside], atol=0.01)
    np.testing.assert_array_equal(found.data.states["y"], exact.states["y"][:-1])


def test_a_delay_that_was_undone_is_in_every_set_and_a_step_of_it_is_hardly_left():
    found = aligned(forced(late={"d(v)/dt": 1.0}))
    statistics = found.evaluations.statistics
    assert [statistics.columns[i].suspect.key for i in found.sets.always] == ["delay of d(v)/dt"]
    (index,) = found.sets.always
    left = statistics.with_target[index] / statistics.products[index, index]
    left *= statistics.target_scale / statistics.columns[index].scale
    assert abs(left) < 2 * MOVED * STEP


def test_the_same_correction_puts_other_data_of_the_same_sensors_right():
    found, other = aligned(forced(late={"F": 0.5})), forced(late={"F": 0.5}, seed=5)
    np.testing.assert_allclose(found.corrected(other).inputs["F"], found.data.inputs["F"], atol=1e-9)


def test_without_delays_nothing_is_touched():
    data = forced(soft)
    found = aligned(data)
    assert found.delays == {} and found.sets.always == () and found.data is data and found.corrected(data) is data
    assert found.sample_noise == {} and found.clipped == {} and found.spurious == 0.0


def test_a_delay_beyond_what_sensors_have_is_not_undone():
    steps = FURTHEST_DELAY * DELAY_STEPS + 2
    found = aligned(forced(late={"d(v)/dt": steps}))
    assert "d(v)/dt" not in found.delays
    keys = [c.suspect.key for c in found.evaluations.statistics.columns if c.suspect is not None]
    assert "delay of d(v)/dt" not in keys


@pytest.mark.parametrize(("wrong", "seed"), [(0.05, 0), (0.05, 2), (0.03, 0)])
def test_a_wrong_coefficient_is_no_late_sensor(wrong, seed):
    # ∂/∂v of the rate is small, and moves it as a delay of the whole rate nearly does.
    study = studied_motion(forced(lambda y, v: -wrong * v, noise=0.12, seed=seed))
    assert study.aligned.delays == {} and study.finding.verdict == "recalibrate"


def test_each_run_is_shifted_by_itself():
    data = forced(soft, n=100, n_run=2, late={"F": 0.5})
    found = aligned(data)
    assert found.delays["F"] / STEP == pytest.approx(0.5, abs=0.03)
    exact = forced(soft, n=100, n_run=2)
    # The last rows of each run have no force yet.
    stay = np.ones(200, bool)
    stay[[99, 199]] = False
    off = np.abs(found.data.inputs["F"] - exact.inputs["F"][stay])
    assert found.data.run_lengths == (99, 99) and off.max() < 0.05 and np.median(off) < 0.01


def test_uneven_samples_have_delays_too():
    data, late = forced(soft, n=300), forced(soft, n=300, late={"F": 0.5})
    keep = np.sort(np.random.default_rng(0).permutation(300)[:240])
    picked = Trajectories.from_arrays(
        data.time[keep],
        states={name: x[keep] for name, x in data.states.items()},
        inputs={"F": late.inputs["F"][keep]},
        derivatives={"v": data.derivatives["v"][keep]},
    )
    assert aligned(picked).delays["F"] == pytest.approx(0.05, abs=0.005)


def test_the_whole_rate_holds_what_was_found():
    data = forced(soft)
    rate = aligned(data).rate(data)
    np.testing.assert_allclose(rate, data.derivatives["v"], atol=0.1)
    assert np.std(rate - data.derivatives["v"]) == pytest.approx(0.02, rel=0.25)


# Noisy states


def test_terms_are_evaluated_at_smoothed_states_where_samples_are_noisy():
    data, exact = forced(soft, n=300, jump=(0.03, 0.0)), forced(soft, n=300)
    found = aligned(data)
    assert set(found.sample_noise) == {"y"}
    noise = found.sample_noise["y"]
    # The standard deviation of 300 differences, by their median, is known to some tenth.
    assert noise.sd == pytest.approx(0.03, rel=0.3) and 0 < noise.left < noise.sd
    off = [np.std(part.states["y"] - exact.states["y"]) for part in (data, found.data)]
    assert off[1] < 0.75 * off[0]
    assert noise.left == pytest.approx(off[1], rel=0.5)


def test_a_delay_that_smoothing_may_imitate_stays_a_suspect_among_others():
    found = aligned(forced(n=300, jump=(0.03, 0.03), late={"F": 0.5}))
    assert found.delays == {} and found.sets.always == ()
    keys = [c.suspect.key for c in found.evaluations.statistics.columns if c.suspect is not None]
    assert "delay of F" in keys


def test_noise_that_is_left_on_states_acts_like_a_force():
    found = aligned(forced(n=300, jump=(0.03, 0.0)))
    # ∂G/∂y is −2 throughout.
    assert found.spurious == pytest.approx(2 * found.sample_noise["y"].left, rel=0.1)


# Clipped samples


def test_rows_at_the_end_of_a_sensor_count_for_nothing():
    data = forced(soft, n=300)
    top = np.quantile(data.derivatives["v"], 0.93)
    blind = replace(data, derivatives={"v": np.minimum(data.derivatives["v"], top)})
    found = aligned(blind)
    np.testing.assert_array_equal(found.clipped["d(v)/dt"], blind.derivatives["v"] == top)
    rows = found.evaluations.statistics.rows
    assert rows.n_row == np.sum(blind.derivatives["v"] != top) and rows.measured.max() < top
    # Other data of that sensor lose their own clipped rows.
    assert found.corrected(forced(n=50)).n_obs == 50
    np.testing.assert_allclose(found.rate(data), aligned(data).rate(data), atol=0.05)


# What is told


def test_it_tells_when_it_takes_suspects_along_the_rate_again():
    told = []
    align(forced_model(), forced(late={"F": 0.5}), "v", [], Odds(), 1, told.append)
    assert told and set(told) == {"taking suspects along the rate with what was found"}
