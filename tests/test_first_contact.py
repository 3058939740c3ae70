"""First contact with a table: stamps, runs and row numbers that are recognised, and a first configuration that runs."""

import re

import numpy as np
import pandas as pd
import pytest

import bayes_greybox as bg
from bayes_greybox.config import load_config
from bayes_greybox.config.starting.held_out import split_of
from bayes_greybox.config.starting.starter import starter
from bayes_greybox.data.reading.door import layout_of
from bayes_greybox.discovery.linearise.source import regressors_of
from bayes_greybox.model.algebra.linalg import require_independent
from bayes_greybox.physics.formula.expressions import parse_expression

N = 60
LEVEL = 20 + 5 * np.exp(-np.arange(N) / 20) + 0.05 * np.random.default_rng(0).standard_normal(N)
VALVE = np.where(np.arange(N) // 10 % 2, 1.0, 0.0)
STAMPS = {
    "Day": np.arange(N), "hours": 0.5 * np.arange(N), "Year": 1900 + np.arange(N), "s": 0.1 * np.arange(N),
    "sec": np.arange(N), "min": 5 * np.arange(N), "Test_Time(s)": np.arange(N), "timestamp": 1.7e9 + 60 * np.arange(N),
}  # fmt: skip


def first_configuration(folder, table, name="run"):
    """Write a table, as text or as a frame, and its first configuration; return that and what is said of it."""
    path, config = folder / f"{name}.csv", folder / f"{name}.toml"
    path.write_text(table if isinstance(table, str) else table.to_csv(index=False))
    start = starter(path, config, layout_of())
    config.write_text(start.text, encoding="utf-8")
    return load_config(config), "\n".join(start.summary)


@pytest.mark.parametrize("name", STAMPS)
@pytest.mark.parametrize("runs", [None, "words", "numbers", "going back"])
def test_stamps_are_recognised_also_where_a_column_tells_runs_apart(name, runs, tmp_path):
    table = pd.DataFrame({name: STAMPS[name], "level": LEVEL, "valve": VALVE})
    if runs is not None:
        parts = [table.assign(run=each, level=LEVEL + each) for each in (1, 2, 3)]
        table = pd.concat(parts).replace({"run": {1: "a", 2: "b", 3: "c"}} if runs == "words" else {})
        table = table.drop(columns="run") if runs == "going back" else table
    data = first_configuration(tmp_path, table)[0].data
    assert (data.time, data.states, data.inputs) == (name, ["level"], ["valve"])
    assert data.run == ("run" if runs in ("words", "numbers") else None)
    assert data.restart == ("run" if runs == "going back" else "error")


def test_the_unit_of_the_time_is_proposed_from_its_name(tmp_path):
    for name, unit in (("Day", "day"), ("hours", "h"), ("sec", "s"), ("Year", "year"), ("Test_Time(s)", "s")):
        settings, _ = first_configuration(tmp_path, pd.DataFrame({name: STAMPS[name], "level": LEVEL}))
        assert f'# t = "{unit}"  # unit of the time, if its name says so' in settings.text


def test_a_temperature_is_no_time(tmp_path):
    table = pd.DataFrame({"T": 20.0 + np.arange(N), "T_amb": VALVE, "Day": np.arange(N)})
    data = first_configuration(tmp_path, table)[0].data
    assert (data.time, data.states, data.inputs) == ("Day", ["T"], ["T_amb"])


@pytest.mark.parametrize("name", ["", "rownames", "n", "obs", "No."])
def test_row_numbers_have_no_role(name, tmp_path):
    table = pd.DataFrame({name: 1 + np.arange(N), "hours": 0.5 * np.arange(N), "level": LEVEL})
    settings, summary = first_configuration(tmp_path, table)
    assert (settings.data.time, settings.data.states) == ("hours", ["level"])
    assert "left out: it counts the rows" in summary


def test_row_numbers_alone_are_no_time(tmp_path):
    data = first_configuration(tmp_path, pd.DataFrame({"rownames": 1 + np.arange(N), "level": LEVEL}))[0].data
    assert (data.time, data.dt, data.states) == (None, 1.0, ["level"])


def test_runs_that_are_numbered_are_told_from_what_changes_between_them(tmp_path):
    # Row numbers from 1, a number for each animal, and what it is fed.
    parts = [
        pd.DataFrame(
            {"weight": 40 + 3 * np.arange(12) + i, "Time": 2 * np.arange(12), "Chick": i, "Diet": (i + 1) // 2}
        )
        for i in (1, 2, 3, 4)
    ]
    table = pd.concat(parts, ignore_index=True)
    table.insert(0, "", 1 + table.index)
    data = first_configuration(tmp_path, table)[0].data
    assert (data.time, data.run, data.states, data.inputs) == ("Time", "Chick", ["weight"], ["Diet"])


HEADERLESS = {
    "commas": "".join(f"{i},{27.1 - 0.3 * i:.2f}\n" for i in range(30)),
    "decimal commas": "".join(f"{0.1 * i:.1f};{27.1 - 0.3 * i:.2f}\n".replace(".", ",") for i in range(30)),
    "dates": "".join(f"2024-01-{i + 1:02d},{27.1 - 0.3 * i:.2f}\n" for i in range(30)),
    "from 0 and 1": "".join(f"{i},{1 + i * i}\n" for i in range(30)),
}


@pytest.mark.parametrize("kind", HEADERLESS)
def test_columns_without_names_are_numbered(kind, tmp_path):
    settings, summary = first_configuration(tmp_path, HEADERLESS[kind])
    assert "no names of columns, which are called c1, c2" in summary
    assert (settings.data.columns, settings.data.time, settings.data.states) == (["c1", "c2"], "c1", ["c2"])
    # The first row is a measurement as well.
    assert settings.data.load(tmp_path, test=False).n_obs == 30


def test_numbers_may_be_names(tmp_path):
    table = "0,1\n" + "".join(f"{0.1 * i:.1f},{27.1 - 0.3 * i:.2f}\n" for i in range(30))
    data = first_configuration(tmp_path, table)[0].data
    assert (data.columns, data.time, data.states) == (None, "0", {"x1": "1"})


def test_the_rate_of_a_speed_is_measured(tmp_path):
    t = 0.01 * np.arange(200)
    v = 3 * np.tanh(t)
    a = 3 / np.cosh(t) ** 2 + 0.05 * np.random.default_rng(1).standard_normal(200)
    for v_name, a_name in (("v [m/s]", "a [m/s^2]"), ("v", "a"), ("omega [rad/s]", "alpha [rad/s^2]")):
        settings, _ = first_configuration(tmp_path, pd.DataFrame({"t [s]": t, v_name: v, a_name: a}))
        state, rate = v_name.split()[0], a_name.split()[0]
        assert (settings.data.states, settings.data.derivatives) == ([state], {state: rate})
    # With the position the speed is its rate, and both are states.
    table = pd.DataFrame({"t [s]": t, "x [m]": 3 * np.log(np.cosh(t)), "v [m/s]": v, "a [m/s^2]": a})
    data = first_configuration(tmp_path, table)[0].data
    assert (data.states, data.derivatives) == (["x", "v"], {"v": "a"})


def test_the_split_of_samples_leaves_a_path_in_each_part():
    # 27 rows, a path of two states: a fifth is 5 samples, and 6 are needed.
    assert split_of({"0": 27}, 2, False)[:2] == (0.25, False)
    assert split_of({"0": 40}, 2, False)[:2] == (0.2, False)
    # Too few rows for any split of each run: whole runs, or none.
    assert split_of({name: 8 for name in "abcdef"}, 2, False)[:2] == (0.2, True)
    # A study needs 20 rows to train on.
    assert split_of({"0": 24}, 0, False)[:2] == (None, False) == split_of({"0": 13}, 1, False)[:2]
    assert split_of({"0": 8}, 2, False)[:2] == (None, False)
    # A run of too few rows is left out.
    assert split_of({"a": 40, "b": 5, "c": 40}, 2, False) == (0.2, False, ("b",), 6)


@pytest.mark.parametrize("rows", [20, 30, 40, 60, 300, 3000])
def test_the_split_of_a_filter_leaves_rows_to_its_longest_window(rows):
    share, *_ = split_of({"0": rows}, None, True)
    if share is None:
        assert rows < 40
        return
    first = round((1 - share) * rows)
    # Three quarters of a third, rounded up to the next odd number.
    assert rows - first >= max(7, min(first // 4 + 2, 301)) + 3


def test_a_short_record_is_split_so_that_it_can_be_studied(tmp_path):
    t = 0.2 + np.cumsum(np.tile([0.03, 0.02, 0.025], 9))
    table = pd.DataFrame({"t (s)": t.round(3), "y (m)": (0.4 - 0.3 * t**2).round(3)})
    settings, _ = first_configuration(tmp_path, table)
    train, test = settings.read_data()
    assert (train.n_obs, test.n_obs, settings.data.test_fraction) == (20, 7, 0.25)


def test_runs_can_be_left_out(tmp_path):
    table = pd.concat([pd.DataFrame({"t": np.arange(20), "y": LEVEL[:20] + i, "run": i}) for i in (1, 2, 3)])
    table.to_csv(tmp_path / "run.csv", index=False)
    text = '[data]\npath = "run.csv"\ntime = "t"\nrun = "run"\nstates = ["y"]\nleave_out = {}\n'
    config = tmp_path / "run.toml"
    for stated in ('["2"]', "[2]"):
        config.write_text(text.format(stated))
        train, test = load_config(config).read_data()
        assert train.run_names == ("1", "3") and test is None
        assert "runs that were left out: 2" in train.remarks
    config.write_text(text.format('["4"]'))
    with pytest.raises(bg.InputError, match="no run '4' to leave out; there are 1, 2, 3"):
        load_config(config).read_data()
    with pytest.raises(bg.InputError, match="No run is left"):
        train.leave_out(["1", "3"])


def test_nothing_is_held_out_by_a_fraction_of_zero(tmp_path):
    pd.DataFrame({"t": np.arange(N), "y": LEVEL}).to_csv(tmp_path / "run.csv", index=False)
    (tmp_path / "run.toml").write_text('[data]\npath = "run.csv"\ntime = "t"\nstates = ["y"]\ntest_fraction = 0\n')
    train, test = load_config(tmp_path / "run.toml").read_data()
    assert train.n_obs == N and test is None


def test_a_file_without_states_is_told_what_to_write(tmp_path):
    pd.DataFrame({"t": np.arange(N), "I": VALVE, "V": LEVEL}).to_csv(tmp_path / "run.csv", index=False)
    text = '[data]\npath = "run.csv"\ntime = "t"\nstates = []\ninputs = ["I"]\n{}[simulation]\nV = "3.8 + 0.02*I"\n'
    (tmp_path / "run.toml").write_text(text.format(""))
    with pytest.raises(bg.InputError, match=r'states = \["V"\] if .* says the rate of .V., or outputs = \["V"\]'):
        load_config(tmp_path / "run.toml")
    (tmp_path / "run.toml").write_text(text.format('outputs = ["V"]\n'))
    assert load_config(tmp_path / "run.toml").read_data()[0].output_names == ("V",)


def test_advice_names_states_of_the_file(tmp_path):
    pd.DataFrame({"t": np.arange(N), "level": LEVEL}).to_csv(tmp_path / "run.csv", index=False)
    (tmp_path / "run.toml").write_text('[data]\npath = "run.csv"\ntime = "t"\nstates = ["level"]\n')
    settings = load_config(tmp_path / "run.toml")
    with pytest.raises(bg.InputError, match=r'add terms such as level = \["level"\]'):
        settings.build_model()
    with pytest.raises(bg.InputError, match=r'\[simulation\] level = "-2\*level"'):
        settings.build_studied_model()
    with pytest.raises(bg.InputError, match=r"dictionary=\{'level': \['level'\]\}"):
        bg.GreyBox().fit(settings.read_data()[0])


def value_of(formula, values):
    parsed = parse_expression(formula)
    return float(parsed.subs({symbol: values[symbol.name] for symbol in parsed.free_symbols}))


@pytest.mark.parametrize(
    "names", [("t [ms]", "pos [mm]", "F [N]"), ("t [s]", "angle [deg]", "torque [N*m]"), ("t [s]", "x [m]", "u [V]")]
)
def test_parameters_are_in_the_units_of_the_table(names, tmp_path):
    t = 10.0 * np.arange(200)
    values = [t, np.cos(t / 300), np.sin(t / 100)]
    settings, _ = first_configuration(tmp_path, pd.DataFrame(dict(zip(names, values, strict=True))))
    stated = re.findall(r"^# (\w) = (\{ value = .*)$", settings.text, flags=re.MULTILINE)
    formula = re.search(r'^# With these the formula is v = "(.*)"\.$', settings.text, flags=re.MULTILINE)[1]
    example = re.search(r'^# v = "\.\.\."  # such as "(.*?)"', settings.text, flags=re.MULTILINE)[1]
    # It is the formula with numbers, in the same units.
    numbers = {name: float(re.search(r"value = ([-+.\de]+)", each)[1]) for name, each in stated}
    point = {"v": 0.3, names[1].split()[0]: 0.7, names[2].split()[0]: 1.3}
    one, other = (value_of(each, numbers | point) for each in (formula, example))
    assert one == pytest.approx(other, rel=2e-3)
    # The comment is a section, once its marks are gone.
    lines = "\n".join(f"{name} = {each}" for name, each in stated)
    config = settings.text.replace("# [parameters]", f"[parameters]\n{lines}")
    config = re.sub('^# v = ".*$', f'v = "{formula}"', config, flags=re.MULTILINE)
    (tmp_path / "again.toml").write_text(config, encoding="utf-8")
    again = load_config(tmp_path / "again.toml")
    assert set(again.parameters) == set(numbers) and again.build_studied_model() is not None


def test_starts_have_an_example_in_the_names_of_the_table(tmp_path):
    table = pd.DataFrame(
        {"Day": np.arange(200), "T_in [°C]": np.cos(np.arange(200) / 30), "T_amb [°C]": np.arange(200) % 7}
    )
    settings, _ = first_configuration(tmp_path, table)
    assert '# tau = { value = 10, sd = 1, lower = 0.0, unit = "day" }' in settings.text
    assert '# With these the formula is T_in = "(T_amb - T_in)/tau".' in settings.text
    assert '# lagging = "T_in"  # beside lagging = "(T_in - lagging)/10" above' in settings.text
    text = settings.text.replace("# [starts]", '[starts]\nlagging = "T_in"')
    text = re.sub(
        '^# T_in = "\\.\\.\\.".*such as.*$',
        'T_in = "(T_amb - lagging)/5"\nlagging = "(T_in - lagging)/10"',
        text,
        flags=re.M,
    )
    (tmp_path / "again.toml").write_text(f'{text}\n[dictionary]\nT_in = ["T_amb"]\n', encoding="utf-8")
    again = load_config(tmp_path / "again.toml")
    train, _ = again.read_data()
    model = again.build_model().on(train)
    assert "lagging" in model.simulator(train).states and model.starts == {"lagging": "T_in"}
    assert [*model.assemble(model.complete(train))] == ["T_in"]


def test_a_hidden_state_without_a_start_or_at_zero_is_asked_for_its_start():
    t = np.linspace(0, 5, 60)
    data = bg.Trajectories.from_arrays(t, states={}, outputs={"V": 3.2 + np.exp(-0.1 * t)}, inputs={"i": np.sin(t)})
    simulation = {"soc": "-0.1*soc", "V": "3.2"}
    for starts, message in (
        ({}, "uses 'soc', which has a formula.*starts={'soc': 1.0}"),
        ({"soc": 0.0}, "as is 'soc'.*starts"),
    ):
        model = bg.GreyBox({"V": ["soc"]}, simulation, starts=starts, discrepancy=None).on(data)
        with pytest.raises(bg.InputError, match=message):
            model.assemble(model.complete(data))


def test_a_term_that_no_sensor_shows_is_not_called_zero():
    columns = np.column_stack([np.ones(9), np.zeros(9)])
    with pytest.raises(bg.InputError, match=r"'I: S\*I' .* no effect on any measurement.*into the simulation"):
        require_independent(columns, ("S: S*I", "I: S*I"), "S_and_I")


def test_a_study_without_a_discrepancy_leaves_out_what_is_constant():
    t = np.linspace(0, 5, 60)
    data = bg.Trajectories.from_arrays(
        t, states={"x": np.exp(-t)}, derivatives={"x": -1.1 * np.exp(-t)}, inputs={"u": np.zeros(60)}, constant="keep"
    )
    model = bg.GreyBox({"x": []}, {"x": "-x"}, discrepancy=None).on(data)
    assert regressors_of(model, data, "x", []).variables == ("x",)
    # One that was asked for is refused, with the remedy.
    asked = bg.GreyBox({"x": []}, {"x": "-x"}).on(data)
    with pytest.raises(bg.InputError, match=r"OrthogonalGP\(variables=\['x'\]\), in a file \[discrepancy\] variables"):
        regressors_of(asked, data, "x", [])
