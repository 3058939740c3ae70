import numpy as np
import pytest
from differentiation import differentiation_matrix

from bayes_greybox.data.rates.filters import filter_taps, savgol_window, spectral_derivative
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError

H = 0.1
T = np.arange(120) * H
SETTINGS = {
    "savgol": {"window": 9, "polyorder": 4},
    "bandlimited": {"band": 2.0},
    "spectral": {"band": 3.0},
}
LINE = {"y": np.sin(T) + 0.3 * T}
WAVE = {"y": np.sin(2 * np.pi * T / 12)}


def records(columns, n):
    """The columns of a matrix as runs, so that each is differentiated on its own."""
    time = np.arange(n) * H
    return Trajectories.from_arrays([time] * columns.shape[1], states={"y": list(columns.T)})


@pytest.mark.parametrize("method", SETTINGS)
def test_identity_pushed_through_recovers_the_matrix(method):
    # A smooth period is added to each unit vector so that the spectral method accepts the record, and its
    # own derivative is taken off again: the operator is linear.
    n = 64
    wave = np.sin(2 * np.pi * np.arange(n) / n)
    columns = np.column_stack([wave, *(wave[:, None] + np.eye(n)).T])
    settings = {"savgol": {"window": 9, "polyorder": 4}, "bandlimited": {"band": 2.5, "window": 11}}.get(
        method, {"band": 3.0}
    )
    data = records(columns, n).differentiate(method, rates={"y": "v"}, **settings)
    for order, rows in ((0, data.states["y"]), (1, data.derivatives["y"]), (2, data.derivatives["v"])):
        out = rows.reshape(n + 1, -1)
        expected = differentiation_matrix(n, H, order, method, **settings)
        np.testing.assert_allclose((out[1:] - out[0]).T, expected, atol=1e-11 * np.abs(expected).max())


def test_polynomials_of_the_filter_degree_are_exact():
    y = 0.2 - T + 0.5 * T**2 - 0.1 * T**3 + 0.01 * T**4
    data = Trajectories.from_arrays(T, states={"y": y}).differentiate(rates={"y": "v"}, window=11)
    t = data.time
    np.testing.assert_allclose(data.states["y"], y[5:-5], atol=1e-10)
    np.testing.assert_allclose(data.states["v"], -1 + t - 0.3 * t**2 + 0.04 * t**3, atol=1e-9)
    np.testing.assert_allclose(data.derivatives["v"], 1 - 0.6 * t + 0.12 * t**2, atol=1e-8)
    np.testing.assert_array_equal(data.derivatives["y"], data.states["v"])


def test_a_sine_over_whole_periods_is_exact_spectrally():
    omega = 2 * np.pi * 5 / (120 * H)
    data = Trajectories.from_arrays(T, states={"y": np.sin(omega * T)}).differentiate("spectral", rates={"y": "v"})
    assert data.n_obs == 120 and data.dropped == 0
    np.testing.assert_allclose(data.states["v"], omega * np.cos(omega * T), atol=1e-10)
    np.testing.assert_allclose(data.derivatives["v"], -(omega**2) * np.sin(omega * T), atol=1e-10)


def test_spectral_band_removes_what_lies_above():
    slow, fast = np.sin(2 * np.pi * 3 * T / 12), np.sin(2 * np.pi * 40 * T / 12)
    np.testing.assert_allclose(spectral_derivative(slow + fast, H, 0, 20), slow, atol=1e-12)


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("band", [0.0015, 0.05, 0.2, 0.4])
def test_bandlimited_response_holds_over_the_pass_band(order, band):
    # The narrowest has 6,700 taps, which took minutes with as many nodes of quadrature.
    # An 80 dB window leaves ripples of 1e-4 of the largest response; twice that for the moment correction.
    taps = filter_taps(order, "bandlimited", band=band)
    k = np.arange(len(taps)) - len(taps) // 2
    omega = 2 * np.pi * np.linspace(0.0, band, 300)
    response = np.exp(1j * np.outer(omega, k)) @ taps
    edge = 2 * np.pi * min(1.25 * band, 0.5)
    np.testing.assert_allclose(response, (1j * omega) ** order, atol=2.5e-4 * edge**order)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_bandlimited_is_exact_for_cubics(order):
    matrix = differentiation_matrix(120, H, order, "bandlimited", band=2.0)
    half = (120 - len(matrix)) // 2
    expected = {0: T**3, 1: 3 * T**2, 2: 6 * T}[order]
    np.testing.assert_allclose(matrix @ T**3, expected[half:-half], atol=1e-8)


@pytest.mark.parametrize("method", ["savgol", "bandlimited"])
def test_every_column_goes_through_the_same_filter(method):
    data = Trajectories.from_arrays(
        T, states={"y": np.sin(T), "z": np.cos(T)}, inputs={"F": np.cos(T)}, derivatives={"z": -np.sin(T)}
    ).differentiate(method, **SETTINGS[method])
    np.testing.assert_allclose(data.states["z"], data.inputs["F"], atol=1e-14)
    np.testing.assert_allclose(data.derivatives["z"], -data.states["y"], atol=1e-12)
    assert set(data.noise) == {"y", "z"}
    # Smoothing a measured derivative lowers its noise; the factor is the norm of the taps.
    assert data.noise["z"].scale < 1.0 and data.noise["z"].n_obs == data.n_obs


@pytest.mark.parametrize("method", ["savgol", "bandlimited"])
def test_an_output_is_filtered_as_a_measured_derivative_is(method):
    given = {"states": {"y": np.sin(T), "z": np.cos(T)}, "derivatives": {"z": -np.sin(T)}, "outputs": {"R": -np.sin(T)}}
    data = Trajectories.from_arrays(T, **given).differentiate(method, **SETTINGS[method])
    np.testing.assert_array_equal(data.rate("R"), data.rate("z"))
    np.testing.assert_array_equal(data.noise["R"].covariance(), data.noise["z"].covariance())
    assert data.output_names == ("R",) and dict(data.filter.orders) == {"z": 0, "R": 0, "y": 1}
    np.testing.assert_array_equal(data.filter.smoothing("R"), data.filter.smoothing("z"))
    back = Trajectories.from_frame(data.to_frame(), **data.metadata())
    np.testing.assert_array_equal(back.rate("R"), data.rate("R"))


def test_no_rate_is_called_as_an_output_is():
    data = Trajectories.from_arrays(T, states={"y": np.sin(T)}, outputs={"R": np.cos(T)})
    with pytest.raises(InputError, match='"R" is measured and cannot be added as the rate of "y"'):
        data.differentiate(rates={"y": "R"})


def test_edges_are_dropped_and_counted_run_by_run():
    data = Trajectories.from_arrays([T, T[:30]], states={"y": [np.sin(T), np.cos(T[:30])]})
    out = data.differentiate(window=7)
    assert out.run_lengths == (114, 24) and out.dropped == 12
    assert out.take(1).time[0] == T[3]
    np.testing.assert_allclose(out.take(1).derivatives["y"], -np.sin(out.take(1).time), atol=2e-4)


def test_units_follow_the_added_state():
    data = Trajectories.from_arrays(T, states=LINE, units={"y": "m", "t": "s"})
    out = data.differentiate(rates={"y": "v"}, window=9)
    assert out.unit("v") == "m/s" and out.derivative_unit("v") == "m/s/s"
    bare = Trajectories.from_arrays(T, states=LINE, units={"y": "m"}).differentiate(rates={"y": "v"}, window=9)
    assert bare.unit("v") is None


def test_split_keeps_the_noise_of_the_rows():
    out = Trajectories.from_arrays(T, states=LINE).differentiate(rates={"y": "v"}, window=9)
    first, second = out.split(0.6)
    n = first.n_obs
    whole = out.noise["v"].scale ** 2 * out.noise["v"].covariance()
    for part, rows in ((first, slice(0, n)), (second, slice(n, None))):
        noise = part.noise["v"]
        np.testing.assert_allclose(noise.scale**2 * noise.covariance(), whole[rows, rows], rtol=1e-12)
    wave = Trajectories.from_arrays(T, states=WAVE).differentiate("spectral")
    with pytest.raises(InputError, match="cannot be split by time"):
        wave.split(0.5)


def test_window_grows_with_the_noise_and_beats_the_shortest():
    rng = np.random.default_rng(3)
    t = np.arange(2000) * 0.02
    shape, noise = np.sin(2 * t), rng.standard_normal(2000)
    windows = [savgol_window([[shape + sd * noise]], 4) for sd in (1e-4, 1e-2, 1e-1)]
    assert windows == sorted(windows) and windows[0] < windows[2]
    data = Trajectories.from_arrays(t, states={"y": shape + 1e-2 * noise})
    chosen, short = data.differentiate(rates={"y": "v"}), data.differentiate(rates={"y": "v"}, window=7)

    def error(out):
        return np.std(out.derivatives["v"] + 4 * np.sin(2 * out.time))

    assert error(chosen) < 0.05 * error(short)
    # What the noise covariance promises is what is there: the truncation error stays below the noise.
    assert error(chosen) < 1.5 * 1e-2 * chosen.noise["v"].scale


def test_noise_free_data_keep_the_shortest_window():
    assert savgol_window([[np.sin(3 * T)]], 4) <= 9


def uneven():
    time = T.copy()
    time[50] += 0.02
    return time


BAD = {
    "uneven": (
        uneven(),
        LINE,
        {},
        r'Run "0" is not sampled evenly: the step after row 49 is 0.12 .*resamp',
    ),
    "short": (T[:8], {"y": LINE["y"][:8]}, {"window": 9}, r'Run "0" has 8 rows, fewer than the window of 9'),
    "no window": (T[:5], {"y": LINE["y"][:5]}, {}, r"too few to choose a window"),
    "even": (T, LINE, {"window": 8}, r"window must be odd"),
    "order": (
        T,
        LINE,
        {"rates": {"y": "v"}, "window": 9, "polyorder": 1},
        r"polyorder 1 cannot give derivative 2",
    ),
    "polyorder": (T, LINE, {"window": 3, "polyorder": 3}, r"above polyorder 3, not 3"),
    "band savgol": (T, LINE, {"band": 1.0}, r"band does not apply to method='savgol'"),
    "no band": (T, LINE, {"method": "bandlimited"}, r"needs band"),
    "high band": (T, LINE, {"method": "bandlimited", "band": 6.0}, r"not below half the sampling rate, 5"),
    "low band": (
        T,
        {"y": np.sin(2 * np.pi * T / 12)},
        {"method": "spectral", "band": 0.01},
        r"No frequency of run",
    ),
    "window": (T, LINE, {"method": "spectral", "window": 9}, r"window does not apply to method='spectral'"),
    "periods": (
        T,
        LINE,
        {"method": "spectral"},
        r'Run "0" is not a whole number of periods: state "y" jumps by',
    ),
    "rate of nothing": (T, LINE, {"rates": {"z": "v"}}, r'rates names "z", which is not a measured state'),
    "rate taken": (T, LINE | {"v": T}, {"rates": {"y": "v"}}, r'"v" is measured and cannot be added'),
    "rate name": (T, LINE, {"rates": {"y": "2v"}}, r'"2v" cannot name the rate of "y"'),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_requests_name_the_thing_and_the_remedy(case):
    time, states, settings, sentence = BAD[case]
    with pytest.raises(InputError, match=sentence):
        Trajectories.from_arrays(time, states=states).differentiate(**settings)


def test_nothing_is_differentiated_twice():
    data = Trajectories.from_arrays(T, states=LINE)
    with pytest.raises(InputError, match="are differentiated already"):
        data.differentiate(window=9).differentiate(window=9)
    measured = Trajectories.from_arrays(T, states=LINE, derivatives={"y": np.cos(T)})
    with pytest.raises(InputError, match="nothing to differentiate"):
        measured.differentiate()
    with pytest.raises(InputError, match='derivative of "y" is already given'):
        measured.differentiate(rates={"y": "v"})


def test_bandlimited_needs_one_spacing():
    data = Trajectories.from_arrays([T, 2 * T], states={"y": [np.sin(T), np.sin(T)]})
    with pytest.raises(InputError, match=r'Run "1" has the step 0.2 but run "0" has 0.1'):
        data.differentiate("bandlimited", band=1.0)
    # Savitzky–Golay takes both; the noisier rows are those of the finer spacing.
    noise = data.differentiate(window=9).noise["y"]
    assert noise.covariance()[0, 0] == pytest.approx(4 * noise.covariance()[-1, -1])


@pytest.mark.parametrize("rate", [1e4, 1e5])
def test_stamps_since_1970_are_even_but_for_their_rounding(rate):
    t = 1.7e9 + np.arange(400) / rate
    data = Trajectories.from_arrays(t, states={"y": np.sin(np.arange(400) / 40)}).differentiate(window=11)
    assert data.n_obs == 390
    uneven = t + np.random.default_rng(0).uniform(0, 0.5 / rate, 400)
    with pytest.raises(InputError, match="not sampled evenly"):
        Trajectories.from_arrays(uneven, states={"y": t - t[0]}).differentiate(window=11)


def test_a_state_that_is_zero_everywhere_is_differentiated_beside_others():
    t = 0.1 * np.arange(80)
    y = np.sin(t) + 0.01 * np.random.default_rng(0).standard_normal(80)
    states = {"y": y, "still": np.zeros(80)}
    data = Trajectories.from_arrays(t, states=states, constant="keep").differentiate()
    assert not np.any(data.derivatives["still"])
    # It has no part in the choice of the window.
    assert data.filter.window == Trajectories.from_arrays(t, states={"y": y}).differentiate().filter.window
