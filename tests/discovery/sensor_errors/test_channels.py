"""Columns of channels that are late, scaled or offset: against a rate that is known in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.sensor_errors.channels import (
    DELAY,
    DELAY_STEPS,
    DRIFT,
    GAIN,
    OFFSET,
    STATES,
    ChannelSuspect,
    as_shown,
    calibrated,
    shifted,
    suspect_columns,
    undone,
    within,
)
from bayes_greybox.model.program import Program

STEP, N = 0.02, 400


def signals(t):
    """Two states and an input, and their rates of change."""
    values = {"x": np.sin(t) + 0.3 * np.cos(2 * t), "v": np.cos(1.3 * t), "u": np.sin(0.7 * t + 1)}
    slopes = {"x": np.cos(t) - 0.6 * np.sin(2 * t), "v": -1.3 * np.sin(1.3 * t), "u": 0.7 * np.cos(0.7 * t + 1)}
    return values, slopes


def G(x, v, u):
    return -(x**3) - 0.4 * v + 2 * u * x


def partial(x, v, u):
    return {"x": -3 * x**2 + 2 * u, "v": -0.4 + 0 * v, "u": 2 * x}


def rate(data):
    return G(data.states["x"], data.states["v"], data.inputs["u"])


def data_of(late=None, own=0.0, starts=(0.0, 3.0)):
    """Channels that show what was so much earlier; the rate of v is exact but for its own lateness."""
    late = late or {}
    times = [start + np.arange(N) * STEP for start in starts]

    def column(name):
        return [signals(t - late.get(name, 0.0))[0][name] for t in times]

    measured = [G(**signals(t - own)[0]) for t in times]
    return Trajectories.from_arrays(
        times, states={"x": column("x"), "v": column("v")}, inputs={"u": column("u")}, derivatives={"v": measured}
    )


def columns_of(data, of=rate):
    return {(s.kind, s.channel): (s, c) for s, c in suspect_columns(data, "v", of)}


@pytest.fixture(scope="module")
def columns():
    return columns_of(data_of())


def inner(column):
    """Away from the ends of runs, where splines are worse."""
    return np.concatenate([run[5:-5] for run in np.split(column, 2)])


def test_every_channel_has_its_suspects(columns):
    assert {key for key in columns if key[0] == DELAY} == {(DELAY, c) for c in ("d(v)/dt", STATES, "x", "v", "u")}
    for kind in (GAIN, OFFSET):
        assert {key for key in columns if key[0] == kind} == {(kind, c) for c in ("d(v)/dt", "x", "v", "u")}
    assert (DRIFT, "d(v)/dt") in columns
    suspect, _ = columns[(DELAY, "u")]
    assert suspect.sd == pytest.approx(DELAY_STEPS * STEP) and suspect.step == pytest.approx(STEP)
    assert suspect.key == "delay of u"


def test_columns_are_the_derivatives_of_the_rate(columns):
    data = data_of()
    parts = [signals(t) for t in np.split(data.time, 2)]
    values, slopes = ({k: np.concatenate([part[i][k] for part in parts]) for k in ("x", "v", "u")} for i in (0, 1))
    d = partial(**values)
    expected = {
        (DELAY, "d(v)/dt"): -sum(d[k] * slopes[k] for k in d),
        (DELAY, STATES): d["x"] * slopes["x"] + d["v"] * slopes["v"],
        (GAIN, "d(v)/dt"): G(**values),
        (OFFSET, "d(v)/dt"): np.ones(2 * N),
    }
    for k in ("x", "v", "u"):
        expected[(DELAY, k)], expected[(GAIN, k)], expected[(OFFSET, k)] = d[k] * slopes[k], -d[k] * values[k], -d[k]
    for key, column in expected.items():
        size = np.max(np.abs(column))
        np.testing.assert_allclose(inner(columns[key][1]), inner(column), atol=1e-3 * size, err_msg=str(key))


@pytest.mark.parametrize("channel", ["d(v)/dt", STATES, "x", "v", "u"])
def test_what_is_late_has_a_positive_delay(channel):
    by = 0.3 * STEP
    names = {"x", "v"} if channel == STATES else {channel}
    data = data_of(dict.fromkeys(names & {"x", "v", "u"}, by), by if channel == "d(v)/dt" else 0.0)
    _, column = columns_of(data)[(DELAY, channel)]
    gap = data.derivatives["v"] - rate(data)
    found = inner(column) @ inner(gap) / (inner(column) @ inner(column))
    assert found == pytest.approx(by, rel=0.05)


@pytest.mark.parametrize("kind", [GAIN, OFFSET])
@pytest.mark.parametrize("channel", ["d(v)/dt", "x", "u"])
def test_what_reads_too_large_has_a_positive_size(kind, channel):
    exact, size = data_of(), 1e-3

    def wrong(values):
        return values * (1 + size) if kind == GAIN else values + size

    measured = wrong(exact.derivatives["v"]) if channel == "d(v)/dt" else exact.derivatives["v"]
    data = Trajectories.from_arrays(
        np.split(exact.time, 2),
        states={k: np.split(wrong(v) if k == channel else v, 2) for k, v in exact.states.items()},
        inputs={k: np.split(wrong(v) if k == channel else v, 2) for k, v in exact.inputs.items()},
        derivatives={"v": np.split(measured, 2)},
    )
    _, column = columns_of(data)[(kind, channel)]
    gap = data.derivatives["v"] - rate(data)
    assert column @ gap / (column @ column) == pytest.approx(size, rel=0.02)


def test_undoing_a_delay_of_exact_data_leaves_the_error_of_a_spline():
    delays = {"x": 0.7 * STEP, "u": -0.4 * STEP, "d(v)/dt": 0.9 * STEP}
    data = data_of({"x": delays["x"], "u": delays["u"]}, delays["d(v)/dt"])
    # The rate that was measured belongs to times that are earlier; so do states and inputs now.
    gap = inner(data.derivatives["v"] - rate(undone(data, "v", delays)))
    assert np.max(np.abs(gap)) < 1e-5 < np.max(np.abs(data.derivatives["v"] - rate(data)))
    together = data_of({"x": 0.5 * STEP, "v": 0.5 * STEP})
    gap = inner(together.derivatives["v"] - rate(undone(together, "v", {STATES: 0.5 * STEP})))
    assert np.max(np.abs(gap)) < 1e-5


def test_nothing_is_done_for_no_delay_and_runs_are_shifted_apart():
    data = data_of()
    assert undone(data, "v", {}) is data and undone(data, "v", {"x": 0.0}) is data
    moved = shifted(data, {"x": STEP})
    assert moved.states["v"] is data.states["v"]
    for own in (slice(0, N), slice(N, 2 * N)):
        np.testing.assert_allclose(moved.states["x"][own][:-1], data.states["x"][own][1:], atol=1e-10)
    few = Trajectories.from_arrays(np.arange(3) * STEP, states={"x": np.array([0.0, 1.0, 0.5])})
    np.testing.assert_array_equal(shifted(few, {"x": STEP}).states["x"], few.states["x"])


@pytest.mark.parametrize(
    "simulation",
    [{"v": "-x**3 - 0.4*v + 2*u*x"}, lambda t, x, u: [0.0 * x[0], G(x[0], x[1], u[0])]],
)
def test_any_simulation_serves(simulation, columns):
    data = data_of()
    known = Program(simulation=simulation).simulator(data)
    found = columns_of(data, lambda d: known.on(d, "v"))
    assert set(found) == set(columns)
    for key, (_, column) in found.items():
        np.testing.assert_allclose(column, columns[key][1], atol=1e-6 * np.max(np.abs(column)), err_msg=str(key))


def test_a_channel_that_the_rate_does_not_see_is_no_suspect():
    data = data_of()
    found = columns_of(data, lambda d: -d.states["v"])
    assert (DELAY, "x") not in found and (GAIN, "u") not in found and (GAIN, "v") in found


def test_gains_offsets_and_drifts_are_taken_out_as_they_were_put_in():
    true = data_of()
    clock = true.time
    drift = 0.2 * (clock - clock.mean()) / np.ptp(clock)
    measured = replace(
        true,
        states={**true.states, "x": 1.02 * true.states["x"] + 0.1},
        inputs={"u": 0.9 * true.inputs["u"]},
        derivatives={"v": 1.05 * true.derivatives["v"] - 0.3 + drift},
    )
    sizes = {
        ChannelSuspect(GAIN, "x", 1.0): 0.02,
        ChannelSuspect(OFFSET, "x", 1.0): 0.1,
        ChannelSuspect(GAIN, "u", 1.0): -0.1,
        ChannelSuspect(GAIN, "d(v)/dt", 1.0): 0.05,
        ChannelSuspect(OFFSET, "d(v)/dt", 1.0): -0.3,
        ChannelSuspect(DRIFT, "d(v)/dt", 1.0): 0.2,
        ChannelSuspect(DELAY, "d(v)/dt", 1.0): 0.01,
    }
    found = calibrated(measured, "v", sizes, true)
    for name in ("x", "v", "u"):
        np.testing.assert_allclose(found.column(name), true.column(name), atol=1e-12)
    np.testing.assert_allclose(found.derivatives["v"], true.derivatives["v"], atol=1e-12)
    # Data of the same sensor at another time go on drifting.
    later = measured.take(1)
    np.testing.assert_allclose(calibrated(later, "v", sizes, true).derivatives["v"], true.take(1).derivatives["v"])
    assert calibrated(measured, "v", {ChannelSuspect(DELAY, "v", 1.0): 0.1}, true) is measured


def test_what_a_sensor_shows_of_a_path_is_taken_out_again():
    true = data_of()
    sizes = {ChannelSuspect(kind, "x", 1.0): size for kind, size in ((GAIN, 0.02), (OFFSET, 0.1), (DRIFT, 0.3))}
    shown = as_shown(true.states["x"][None], "x", true, sizes, true)[0]
    measured = replace(true, states={**true.states, "x": shown})
    np.testing.assert_allclose(calibrated(measured, "v", sizes, true).states["x"], true.states["x"], atol=1e-12)
    assert not np.allclose(shown, true.states["x"])
    # A late sensor shows what was before; another state's errors, and paths that failed, are left as they are.
    late = {ChannelSuspect(DELAY, "x", 1.0): 0.03, ChannelSuspect(GAIN, "v", 1.0): 0.5}
    paths = np.stack([np.sin(true.time), np.full(true.n_obs, np.nan)])
    seen = as_shown(paths, "x", true, late, true)
    inside = np.concatenate([np.arange(5, n) for n in true.run_lengths[:1]])
    np.testing.assert_allclose(seen[0, inside], np.sin(true.time - 0.03)[inside], atol=1e-4)
    assert np.all(np.isnan(seen[1])) and np.array_equal(paths[0], np.sin(true.time))


def test_a_rate_with_a_clock_of_its_own_is_late_with_it():
    def swept(data):
        return np.sin(0.3 * data.time**2) - data.states["x"]

    data, d = data_of(), 0.3 * STEP
    late = {(s.kind, s.channel): c for s, c in suspect_columns(data, "v", swept)}[DELAY, "d(v)/dt"]
    slope = 0.6 * data.time * np.cos(0.3 * data.time**2) - signals(data.time)[1]["x"]
    inner = np.arange(2 * N) % N
    inner = (inner > 2) & (inner < N - 3)
    np.testing.assert_allclose(late[inner], -slope[inner], atol=2e-3 * np.abs(slope).max())
    assert undone(data, "v", {"d(v)/dt": d}).time == pytest.approx(data.time - d)


def test_rows_without_a_measurement_where_a_delay_takes_them_are_told():
    data = data_of()
    inside = within(data, "v", {"u": 2.5 * STEP})
    np.testing.assert_array_equal(np.flatnonzero(~inside), [N - 3, N - 2, N - 1, 2 * N - 3, 2 * N - 2, 2 * N - 1])
    assert within(data, "v", {}).all()


def test_inputs_taken_later_hold_their_ends_and_keep_their_steps():
    t = 0.1 * np.arange(60)
    smooth, step = np.sin(t), np.where(np.sin(3 * t) > 0, 1.0, 0.0)
    data = Trajectories.from_arrays(t, states={"x": smooth}, inputs={"u": smooth, "s": step})
    later = shifted(data, {"u": 0.07, "s": 0.07})
    inside = t + 0.07 <= t[-1]
    np.testing.assert_allclose(later.inputs["u"][inside], np.sin(t + 0.07)[inside], atol=1e-4)
    assert later.inputs["u"][-1] == pytest.approx(smooth[-1])
    assert later.inputs["s"].min() >= 0 and later.inputs["s"].max() <= 1
    np.testing.assert_allclose(shifted(data, {"u": -9.0}).inputs["u"], smooth[0], atol=1e-12)


@pytest.mark.parametrize("samples", [0.3, 1.0])
def test_behind_a_leap_a_late_channel_is_no_straight_line_but_its_column_is_exact(samples):
    """An output that follows a switched current, late by less than a sample or by a whole one; and a late current."""
    t, d = STEP * np.arange(200), samples * STEP
    current = np.repeat(np.random.default_rng(0).integers(-2, 4, 20), 10) * 1.0
    data = Trajectories.from_arrays(t, states={}, inputs={"i": current}, outputs={"V": -0.05 * current})

    def voltage(data):
        return -0.05 * data.inputs["i"]

    columns = {(s.kind, s.channel): column for s, column in suspect_columns(data, "V", voltage)}
    before, after = np.append(current[:1], current[:-1]), np.append(current[1:], current[-1:])
    for channel, other in (("V", before), ("i", after)):
        mixed = (1 - samples) * current + samples * other
        np.testing.assert_allclose(-0.05 * current + d * columns[DELAY, channel], -0.05 * mixed, atol=1e-12)
    np.testing.assert_allclose(undone(data, "V", {"V": STEP}).inputs["i"], before, atol=1e-12)


@pytest.mark.parametrize("samples", [-1.0, -0.4, 0.4, 1.0])
def test_a_switched_input_that_is_late_or_early_has_its_column_beside_a_state(samples):
    """A recorded command that acts later is an input that is early; the rate is of a state, too."""
    t, d = STEP * np.arange(400), samples * STEP
    command = np.repeat(np.random.default_rng(0).integers(-2, 4, 20), 20) * 1.0
    true = shifted(Trajectories.from_arrays(t, states={"x": t}, inputs={"u": command}), {"u": d}).inputs["u"]
    state = np.sin(0.7 * t)
    measured = 2.0 * true - 0.3 * state
    data = Trajectories.from_arrays(t, states={"x": state}, inputs={"u": command}, derivatives={"x": measured})
    found = suspect_columns(data, "x", lambda at: 2.0 * at.inputs["u"] - 0.3 * at.states["x"])
    column = {error.key: column for error, column in found}["delay of u"]
    lacking = measured - 2.0 * command + 0.3 * state
    np.testing.assert_allclose(d * column[1:-1], lacking[1:-1], atol=1e-12)


def test_noise_of_an_input_is_no_delay():
    """Half a sample in lines is the mean of two neighbours, which has less noise: beside no leap both sides count."""
    t, noise = STEP * np.arange(400), np.random.default_rng(1).standard_normal(400)
    inputs, rates = {"u": 1.0 + 0.1 * noise}, {"x": np.ones(400)}
    data = Trajectories.from_arrays(t, states={"x": np.sin(t)}, inputs=inputs, derivatives=rates)
    found = {error.key: column for error, column in suspect_columns(data, "x", lambda at: at.inputs["u"])}
    column, lacking = found["delay of u"], 1.0 - data.inputs["u"]
    # Of 400 samples a correlation of white noise has a standard deviation of 0.05.
    assert abs(lacking @ column) / np.sqrt((lacking @ lacking) * (column @ column)) < 0.2


@pytest.mark.parametrize(("levels", "before"), [((4.0, 5, 0.0), 0.0), ((4.0, 30, 0.0), 4.0), ((0.0, 5, 4.0), 0.0)])
def test_before_a_run_an_input_may_rest(levels, before):
    """A dose at the start of a record is the first; a heater that is on at the start of most of it may have been on.

    And a step that follows rest is preceded by rest.
    """
    first, on, then = levels
    t, late = STEP * np.arange(40), -1.5 * STEP
    values = np.where(np.arange(40) < on, first, then)
    data = Trajectories.from_arrays(t, states={"x": np.sin(t)}, inputs={"u": values})
    moved = shifted(data, {"u": late}).inputs["u"]
    np.testing.assert_allclose(moved[:3], [before, 0.5 * (before + first), first], atol=1e-12)
    # What was cut off before a held-out part is no rest.
    cut = replace(data, before=data)
    assert shifted(cut, {"u": late}).inputs["u"][0] == first


# Rates that a filter computed


def oscillator(t):
    """Displacement, velocity, acceleration and an input of a motion that is known at all times."""
    x = np.sin(1.7 * t) + 0.4 * np.cos(3.1 * t)
    v = 1.7 * np.cos(1.7 * t) - 1.24 * np.sin(3.1 * t)
    a = -(1.7**2) * np.sin(1.7 * t) - 0.4 * 3.1**2 * np.cos(3.1 * t)
    return x, v, a, (a + 2 * x + 0.3 * v) / 1.5


def computed(late=0.0, early=0.0, gain=0.0, offset=0.0):
    """One displacement, shown late and too large, from which the velocity and its rate are computed; and an input."""
    t = STEP * np.arange(N)
    shown = (1 + gain) * oscillator(t - late)[0] + offset
    samples = Trajectories.from_arrays(t, states={"x": shown}, inputs={"u": oscillator(t + early)[3]})
    return samples.differentiate(rates={"x": "v"}, window=11)


def force(data):
    return -2 * data.states["x"] - 0.3 * data.states["v"] + 1.5 * data.inputs["u"]


def test_a_computed_rate_has_no_sensor_of_its_own():
    keys = {key for key, _ in columns_of(computed(), force).items()}
    assert keys == {(DELAY, "u"), (DELAY, STATES), (GAIN, "x"), (GAIN, "u"), (OFFSET, "x"), (OFFSET, "u")}


def test_a_state_with_a_sensor_of_its_own_is_late_by_itself():
    t = STEP * np.arange(N)
    x, v, _, u = oscillator(t)
    data = Trajectories.from_arrays(t, states={"x": x, "v": v}, inputs={"u": u}, derivatives={"x": v})
    found = columns_of(data.differentiate(window=11), force)
    assert {channel for kind, channel in found if kind == DELAY} == {"u", STATES, "v", "x"}
    # The rate is computed from v: that it is late is that x and u are early.
    np.testing.assert_allclose(found[DELAY, "v"][1], -(found[DELAY, "x"][1] + found[DELAY, "u"][1]), atol=1e-9)
    np.testing.assert_allclose(found[DELAY, STATES][1], -found[DELAY, "u"][1], atol=1e-9)


@pytest.mark.parametrize(
    ("kind", "channel", "wrong"),
    [(DELAY, STATES, {"late": 0.004}), (DELAY, "u", {"early": -0.004}), (GAIN, "x", {"gain": 0.004})],
)
def test_an_error_of_the_samples_is_one_of_all_that_was_computed_from_them(kind, channel, wrong):
    data = computed(**wrong)
    suspect, column = columns_of(data, force)[kind, channel]
    gap, edge = data.derivatives["v"] - force(data), slice(10, -10)
    found = column[edge] @ gap[edge] / (column[edge] @ column[edge])
    assert found == pytest.approx(0.004, rel=0.03)
    exact = computed()
    put_right = calibrated(data, "v", {suspect: found}, data) if kind == GAIN else undone(data, "v", {channel: found})
    left = put_right.derivatives["v"] - force(put_right)
    assert np.std(left[edge]) < 0.05 * np.std(gap[edge])
    if kind == GAIN:
        for name in ("x", "v"):
            np.testing.assert_allclose(put_right.states[name], exact.states[name], rtol=3e-4, atol=1e-9)
        shown = as_shown(exact.states["v"][None], "v", data, {suspect: found}, data)[0]
        np.testing.assert_allclose(shown, data.states["v"], rtol=3e-4, atol=1e-9)


def test_a_constant_in_samples_is_none_in_what_was_computed_from_them():
    data, suspect = computed(offset=0.01), ChannelSuspect(OFFSET, "x", 0.1)
    put_right = calibrated(data, "v", {suspect: 0.01}, data)
    np.testing.assert_array_equal(put_right.states["v"], data.states["v"])
    np.testing.assert_array_equal(put_right.derivatives["v"], data.derivatives["v"])
    np.testing.assert_allclose(put_right.states["x"], computed().states["x"], atol=1e-9)
    assert np.array_equal(as_shown(data.states["v"][None], "v", data, {suspect: 0.01}, data)[0], data.states["v"])


def test_noise_in_a_computed_rate_is_no_late_sensor():
    """The slope of a state is its computed rate: noise of the one would be explained by that of the other."""
    t = STEP * np.arange(N)
    noisy = oscillator(t)[0] + 1e-4 * np.random.default_rng(0).standard_normal(N)
    samples = Trajectories.from_arrays(t, states={"x": noisy}, inputs={"u": oscillator(t)[3]})
    data = samples.differentiate(rates={"x": "v"}, window=5)
    noise = data.derivatives["v"] - force(data)
    for _, column in columns_of(data, force).values():
        assert abs(np.corrcoef(column, noise)[0, 1]) < 0.2


def test_all_states_are_shown_late_together():
    data = data_of()
    sizes = {ChannelSuspect(DELAY, STATES, 0.1): 0.3 * STEP, ChannelSuspect(DELAY, "x", 0.1): 0.2 * STEP}
    for name, late in (("x", 0.5), ("v", 0.3)):
        shown = as_shown(data.states[name][None], name, data, sizes, data)[0]
        other = data_of({name: late * STEP}).states[name]
        np.testing.assert_allclose(inner(shown), inner(other), atol=1e-6)
