import numpy as np
import pandas as pd
import pytest

from bayes_greybox.data.columns import stack
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError

T = np.linspace(0.0, 1.0, 11)


def one_run(**changes):
    arguments = {
        "t": T,
        "states": {"y": np.sin(T), "ydot": np.cos(T)},
        "derivatives": {"ydot": -np.sin(T)},
        "inputs": {"F": T**2},
        "units": {"y": "m", "ydot": "m/s", "F": "N", "t": "s"},
    } | changes
    return Trajectories.from_arrays(arguments.pop("t"), **arguments)


def two_runs():
    short = T[:7]
    return Trajectories.from_arrays(
        [T, short],
        states={"y": [np.sin(T), np.cos(short)]},
        inputs={"F": [T**2, short]},
        derivatives={"y": [np.cos(T), -np.sin(short)]},
        run_names=["long", "short"],
    )


def test_columns_and_matrix_keep_values_and_order():
    data = one_run()
    assert (data.n_obs, data.n_run) == (11, 1)
    assert data.state_names == ("y", "ydot") and data.input_names == ("F",)
    assert data.derivative_names == ("ydot",)
    np.testing.assert_array_equal(data.matrix(["F", "y"]), np.column_stack([T**2, np.sin(T)]))
    np.testing.assert_array_equal(data.column("F"), T**2)
    assert list(data.columns) == ["y", "ydot", "F"]
    assert data.matrix([]).shape == (11, 0)


def test_plain_lists_of_numbers_are_one_run():
    data = Trajectories.from_arrays([0.0, 1.0, 2.0], states={"y": [1, 2, 4]})
    assert data.n_run == 1 and data.n_obs == 3


def test_derivative_unit_is_state_over_time_unless_given():
    assert one_run().derivative_unit("ydot") == "m/s/s"
    assert one_run(units={"ydot": "m/s", "d(ydot)/dt": "g"}).derivative_unit("ydot") == "g"
    assert one_run(units={"ydot": "m/s"}).derivative_unit("ydot") is None


def test_runs_of_unequal_length_stack_and_come_apart():
    data = two_runs()
    assert data.run_lengths == (11, 7)
    np.testing.assert_array_equal(data.run, [0] * 11 + [1] * 7)
    short = data.take("short")
    np.testing.assert_array_equal(short.states["y"], np.cos(T[:7]))
    np.testing.assert_array_equal(short.run, np.zeros(7))
    assert short.run_names == ("short",)
    np.testing.assert_array_equal(data.take(-1).time, data.take(1).time)


def test_split_by_time_is_contiguous_in_every_run():
    first, second = two_runs().split(0.6)
    assert first.run_lengths == (7, 4) and second.run_lengths == (4, 3)
    np.testing.assert_array_equal(np.concatenate([first.take(0).time, second.take(0).time]), T)
    assert first.take(1).time[-1] < second.take(1).time[0]


def test_split_by_trajectory_takes_whole_runs():
    first, second = two_runs().split(0.9, by="trajectory")
    assert first.run_names == ("long",) and second.run_names == ("short",)
    np.testing.assert_array_equal(second.run, np.zeros(7))
    np.testing.assert_array_equal(second.derivatives["y"], -np.sin(T[:7]))


@pytest.mark.parametrize("differentiated", [False, True])
def test_frame_round_trip_is_exact(differentiated):
    data = two_runs()
    if differentiated:
        data = Trajectories.from_arrays(
            [T, T[:9]], states={"y": [np.sin(T), np.exp(T[:9])]}, units={"y": "m", "t": "s"}
        ).differentiate(rates={"y": "v"}, window=5)
    back = Trajectories.from_frame(data.to_frame(), **data.metadata())
    assert back.metadata() == data.metadata()
    for kind in ("states", "inputs", "derivatives"):
        for name, values in getattr(data, kind).items():
            np.testing.assert_array_equal(getattr(back, kind)[name], values)
    np.testing.assert_array_equal(back.time, data.time)
    np.testing.assert_array_equal(back.run, data.run)
    for name, noise in data.noise.items():
        np.testing.assert_array_equal(back.noise[name].covariance(), noise.covariance())


def test_from_frame_names_an_absent_column():
    with pytest.raises(InputError, match='no column "z"'):
        Trajectories.from_frame(one_run().to_frame(), states=["z"])


@pytest.mark.parametrize("labels", [[0, 1], ["long", "short"], [3, 7], [0.0, 1.0]], ids=str)
def test_from_frame_takes_the_runs_from_the_table(labels):
    """With two runs in the table and none named, the data said that there was one, and could not be split."""
    data = two_runs()
    table = data.to_frame().assign(run=np.repeat(labels, data.run_lengths))
    back = Trajectories.from_frame(table, states=["y"], inputs=["F"], derivatives=["y"])
    assert back.run_names == tuple(str(int(x)) if isinstance(x, float) else str(x) for x in labels)
    assert back.run_lengths == (11, 7) and "18 rows in 2 runs" in repr(back)
    np.testing.assert_array_equal(back.run, data.run)
    first, second = back.split(0.5)
    assert first.n_obs + second.n_obs == 18
    np.testing.assert_array_equal(back.take(back.run_names[1]).states["y"], data.take("short").states["y"])
    named = Trajectories.from_frame(data.to_frame(), **data.metadata())
    assert named.run_names == ("long", "short")
    by_name = data.to_frame().assign(run=np.repeat(["long", "short"], data.run_lengths))
    assert Trajectories.from_frame(by_name, **data.metadata()).metadata() == data.metadata()


@pytest.mark.parametrize(
    ("run", "names", "said"),
    [
        ([0, 1, 0], None, r"Rows of run .* do not lie together: row 2 .*sort_values.*bg\.read\("),
        (["a", None, "b"], None, "names no run in row 1"),
        ([0, 0, 1], ["0"], "has the run '1', which run_names does not name: it has 0"),
        (["a", "a", "b"], ["a", "c"], "has the run 'b', which run_names does not name: it has a, c"),
        ([1, 1, 1], ["a", "b"], "has the runs 1, but run_names names a, b in this order"),
        (["b", "b", "a"], ["a", "b"], "has the runs b, a, but run_names names a, b in this order"),
    ],
)
def test_from_frame_refuses_runs_that_it_cannot_number(run, names, said):
    table = pd.DataFrame({"t": [0.0, 1.0, 2.0], "run": run, "y": [1.0, 2.0, 4.0]})
    with pytest.raises(InputError, match=said):
        Trajectories.from_frame(table, states=["y"], run_names=names)


def test_missing_rows_are_dropped_with_a_count_on_request():
    y = np.sin(T)
    y[[3, 5]] = np.nan
    force = T**2
    force[5] = np.inf
    data = Trajectories.from_arrays(T, states={"y": y}, inputs={"F": force}, missing="drop")
    assert data.dropped == 2
    np.testing.assert_array_equal(data.time, np.delete(T, [3, 5]))
    assert "2 dropped" in repr(data)


def test_summary_and_repr_say_what_is_there():
    data = one_run()
    table = data.summary()
    assert list(table.columns) == ["kind", "unit", "min", "max", "mean", "n"]
    assert table.loc["F", "kind"] == "input" and table.loc["F", "max"] == 1.0
    assert table.loc["d(ydot)/dt", "unit"] == "m/s/s"
    for word in ("11 rows", "1 run", "y, ydot", "F"):
        assert word in repr(data)


def with_output(**changes):
    return one_run(**{"outputs": {"R": np.exp(T)}, "units": {"y": "m", "ydot": "m/s", "R": "kN", "t": "s"}, **changes})


def test_an_output_is_measured_and_no_column():
    data = with_output()
    assert data.output_names == ("R",) and data.derivative_names == ("ydot",) and "R" not in data.columns
    np.testing.assert_array_equal(data.rate("R"), np.exp(T))
    assert data.target_label("R") == "R" and data.target_label("ydot") == "d(ydot)/dt"
    assert data.target_in_words("ydot", "R", "y", article="the ") == "the rate and R"
    table = data.summary()
    assert table.loc["R", ["kind", "unit"]].tolist() == ["output", "kN"] and table.loc["R", "max"] == np.e
    assert "derivatives of ydot; outputs R)" in repr(data)


def test_rows_of_an_output_stay_with_the_others():
    data = with_output()
    first, second = data.split(0.5)
    np.testing.assert_array_equal(np.append(first.rate("R"), second.rate("R")), np.exp(T))
    np.testing.assert_array_equal(data.keep(T > 0.5).rate("R"), np.exp(T[T > 0.5]))
    back = Trajectories.from_frame(data.to_frame(), **data.metadata())
    assert back.output_names == ("R",) and back.metadata() == data.metadata()
    pd.testing.assert_frame_equal(back.to_frame(), data.to_frame())


def test_beside_inputs_and_outputs_there_may_be_no_state():
    data = Trajectories.from_arrays(np.arange(11), inputs={"p": T**2}, outputs={"q": [T]})
    assert data.state_names == () and data.matrix(("p",)).shape == (11, 1)
    assert repr(data) == "Trajectories(11 rows in 1 run; inputs p; outputs q)"


def test_constant_input_is_allowed_in_held_out_data():
    assert one_run(inputs={"F": np.zeros(11)}, units={}, constant="keep").n_obs == 11


def with_nan(values, *rows):
    out = np.array(values, dtype=float)
    out[list(rows)] = np.nan
    return out


BAD = {
    "length": ({"inputs": {"F": T[:-1]}}, r'input "F" of run "0" has 10 rows but the time has 11'),
    "shape": ({"inputs": {"F": np.ones((11, 2))}}, r'input "F" of run "0" has shape \(11, 2\)'),
    "backward": ({"t": np.r_[T[:5], T[3], T[6:]]}, r"row 5 goes back from 0.4 to 0.3; sort the rows"),
    "duplicate": ({"t": np.r_[T[:5], T[4], T[6:]]}, r"stamp 0.4 twice \(row 5\); remove one"),
    "nan": ({"inputs": {"F": with_nan(T, 4, 6)}}, r'input "F" has 2 missing .* in row 4 of run "0".*drop'),
    "nan derivative": (
        {"derivatives": {"ydot": with_nan(T, 2)}},
        r'derivative of "ydot" has 1 missing .* row 2',
    ),
    "nan time": ({"t": with_nan(T, 1)}, r"The time has 1 missing"),
    "constant state": (
        {"states": {"y": np.ones(11), "ydot": T}},
        r'state "y" is constant .*leave it out.*\'1\'',
    ),
    "one row": ({"t": [0.0], "states": {"y": [1.0]}, "inputs": {}, "derivatives": {}, "units": {}}, "There is one row"),
    "constant input": ({"inputs": {"F": np.zeros(11)}}, r'input "F" is constant \(0 in every row\)'),
    "clash": ({"inputs": {"y": T}, "units": {}}, r'"y" is both a state and an input'),
    "reserved": ({"inputs": {"t": T}, "units": {}}, r'name "t" is taken by the time'),
    "reserved in results": ({"inputs": {"obs_id": T}, "units": {}}, r'name "obs_id" is taken by the number of the row'),
    "name": ({"inputs": {"the force": T}, "units": {}}, r"'the force' cannot be used as a name"),
    "derivative": ({"derivatives": {"z": T}}, r'given for "z", which is no state; the states are y, ydot'),
    "unit": ({"units": {"z": "m"}}, r'unit is given for "z", which is no column'),
    "text": ({"inputs": {"F": ["a"] * 11}}, r'input "F" of run "0" is not numeric'),
    "no state": ({"states": {}, "derivatives": {}, "units": {}}, r"no state"),
    "output alone": (
        {"states": {}, "derivatives": {}, "inputs": {}, "units": {}, "outputs": {"R": T}},
        r"nothing that an output could depend on; give at least one column in states=.* or inputs=",
    ),
    "output and state": ({"outputs": {"y": T}}, r'"y" is both an output and a state; rename one'),
    "output and input": ({"outputs": {"F": T}}, r'"F" is both an output and an input'),
    "nan output": ({"outputs": {"R": with_nan(T, 2)}}, r'output "R" has 1 missing .* row 2'),
    "rate of an output": ({"outputs": {"R": T}, "units": {"d(R)/dt": "N/s"}}, r'"d\(R\)/dt", which is no column'),
    "run names": ({"run_names": ["a", "b"]}, r"1 runs but 2 run names"),
    "runs": ({"t": [T, T]}, r'state "y" has 1 runs but the time has 2'),
    "empty": (
        {"t": [T[:0]], "states": {"y": [T[:0]]}, "derivatives": {}, "inputs": {}, "units": {}},
        r'Run "0" has no rows',
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_names_the_thing_and_the_remedy(case):
    changes, sentence = BAD[case]
    with pytest.raises(InputError, match=sentence):
        one_run(**changes)


def test_bad_values_in_a_later_run_are_numbered_within_that_run():
    with pytest.raises(InputError, match=r'in row 3 of run "1"'):
        Trajectories.from_arrays([T, T], states={"y": [np.sin(T), with_nan(T, 3)]})
    with pytest.raises(InputError, match=r'time of run "1" is not increasing: row 1'):
        Trajectories.from_arrays([T, T[::-1]], states={"y": [np.sin(T), T]})
    with pytest.raises(InputError, match=r'Run name "a" occurs twice'):
        Trajectories.from_arrays([T, T], states={"y": [np.sin(T), T]}, run_names=["a", "a"])
    with pytest.raises(InputError, match=r'Run "1" has no row without missing values'):
        Trajectories.from_arrays([T, T], states={"y": [T, with_nan(T, *range(11))]}, missing="drop")


def test_requests_that_cannot_be_met():
    data = one_run()
    with pytest.raises(InputError, match=r'no state or input "z"; there are y, ydot, F'):
        data.column("z")
    with pytest.raises(InputError, match=r"no run 'b'; there are 0"):
        data.take("b")
    with pytest.raises(InputError, match=r"fraction must lie between 0 and 1"):
        data.split(1.0)
    with pytest.raises(InputError, match=r"two runs or more; use by='time'"):
        data.split(0.5, by="trajectory")
    single = Trajectories.from_arrays([T, T[:1]], states={"y": [T, T[:1]]})
    with pytest.raises(InputError, match=r'Run "1" has one row'):
        single.split(0.5)


@pytest.mark.parametrize("values", [[1.0, "high", 2.0], [{}, 1.0, 2.0]])
def test_columns_that_are_no_numbers_are_named(values):
    with pytest.raises(InputError, match='state "y" of run .* is not numeric; convert it to numbers'):
        stack('state "y"', [values], ("0",), [3])


def test_rows_that_are_kept_are_the_same_rows_of_the_same_runs():
    t = np.arange(6.0)
    data = Trajectories.from_arrays(
        [t, t, t], states={"x": [t, t + 10, t + 20]}, derivatives={"x": [t, t, t]}, run_names=["a", "b", "c"]
    )
    rows = np.tile([True, False, True, True, False, True], 3)
    rows[6:12] = False
    kept = data.keep(rows)
    assert kept.run_names == ("a", "c") and kept.run_lengths == (4, 4) and kept.dropped == 10
    np.testing.assert_array_equal(kept.states["x"], [0, 2, 3, 5, 20, 22, 23, 25])
    assert data.keep(np.ones(18, bool)) is data
    with pytest.raises(InputError, match="No row is left"):
        data.keep(np.zeros(18, bool))
    x = np.sin(np.arange(60) * 0.1)
    filtered = Trajectories.from_arrays(np.arange(60) * 0.1, states={"x": x}).differentiate(window=7)
    with pytest.raises(InputError, match="before data.differentiate"):
        filtered.keep(np.arange(filtered.n_obs) > 3)
