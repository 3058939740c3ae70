"""The first configuration that is written for a table: what it guesses, and that it runs."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from shell import refuse

import bayes_greybox as bg
from bayes_greybox import cli
from bayes_greybox.config import load_config
from bayes_greybox.criticism.convergence import MIN_ESS, convergence_table
from bayes_greybox.discovery.subject import studied_equations

N = 600
T = np.arange(N) * 0.02
FORCE = np.sin(0.7 * T) + 0.3 * np.sign(np.sin(2.1 * T))


def oscillator():
    def rate(t, x):
        return [x[1], np.interp(t, T, FORCE) - 4 * x[0] - 0.3 * x[1]]

    y, v = solve_ivp(rate, (0, T[-1]), [1, 0], t_eval=T, rtol=1e-8).y
    return y, v, FORCE - 4 * y - 0.3 * v


def noisy(values, size, seed):
    return values + size * np.random.default_rng(seed).standard_normal(len(values))


def measured_rates():
    y, v, a = oscillator()
    columns = {"Time (s)": T, "Pos [m]": y, "Vel [m/s]": v, "acc": noisy(a, 0.02, 0), "Load cell": FORCE, "gain": 2.0}
    return pd.DataFrame({**columns, "note": "x"})


def position_alone():
    return pd.DataFrame({"t": T, "y": noisy(oscillator()[0], 1e-3, 0), "F": FORCE})


def two_levels():
    stamps = T + np.random.default_rng(0).uniform(-0.004, 0.004, N)
    levels = {"level 1": noisy(np.exp(-stamps / 5), 1e-3, 1), "level 2": noisy(np.exp(-stamps / 3), 1e-3, 2)}
    return pd.DataFrame({"t": stamps, **levels, "trial": np.repeat(["a", "b"], N // 2)})


TABLES = {
    "measured rates": (measured_rates, {}),
    "position alone": (position_alone, {"sep": ";", "decimal": ","}),
    "two levels": (two_levels, {}),
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def written(name, folder, **changes):
    make, options = TABLES[name]
    table = make().assign(**changes)
    table.to_csv(folder / "run.csv", index=False, **options)
    assert cli.main(["init", "run.csv"]) == 0
    return load_config(folder / "run.toml")


def for_fit(settings):
    """The configuration with its dictionary, which is a comment where no rate was measured."""
    text = settings.text
    if "# For bayes-greybox fit" in text:
        text = re.sub(r'^# (?=\[dictionary\]|\w+ = \["1")', "", text, flags=re.MULTILINE)
        text = re.sub(r"^\w+ = \[\]\n", "", text, flags=re.MULTILINE)
    settings._path.write_text(text, encoding="utf-8")
    return load_config(settings._path)


@pytest.mark.parametrize("name", TABLES)
def test_what_is_written_is_a_configuration_that_builds_data_and_model(name, here, capsys):
    settings = written(name, here)
    assert "check what was guessed" in capsys.readouterr().out
    train, test = settings.read_data()
    model = for_fit(settings).build_model()
    completed = model.on(train)
    completed.dictionaries(train)
    assert test.n_obs and set(model.equations) <= {*completed.states(train), *train.output_names}
    assert for_fit(settings).build_studied_model() is not None
    # Comments say what is to be filled in.
    assert "unit of" in settings.text and 'such as "' in settings.text


def test_rates_and_inputs_are_known_by_their_behaviour(here):
    settings = written("measured rates", here)
    train, _ = settings.read_data()
    assert train.state_names == ("Pos", "Vel") and train.input_names == ("Load_cell",)
    assert train.derivative_names == ("Vel",) and settings.simulation == {"Pos": "Vel"}
    assert train.units == {"t": "s", "Pos": "m", "Vel": "m/s"}
    # An example of the equation in the table's units.
    assert (
        '# Vel = "..."  # such as "Load_cell/2 - 15*Pos - 0.4*Vel" (2 kg, 30 N/m, 0.8 N s/m in m, s, N)'
        in settings.text
    )
    assert "# gain has no role: it never changes." in settings.text and "# note has no role" in settings.text


def test_a_position_has_a_rate_that_is_learned(here):
    settings = written("position alone", here)
    train, _ = settings.read_data()
    assert settings.data.decimal == "," and settings.simulation == {"y": "v"}
    # It is followed along its samples; rates of a filter are a comment away.
    assert train.filter is None and "# [data.differentiate]" in settings.text
    text = re.sub(r"^# (\[data\.differentiate\]|rates = )", r"\1", settings.text, flags=re.MULTILINE)
    settings._path.write_text(text, encoding="utf-8")
    filtered, _ = load_config(settings._path).read_data()
    assert filtered.filter is not None and filtered.derivative_names == ("y", "v")


def test_two_positions_have_rates_that_are_computed(here):
    settings = written("position alone", here, z=noisy(np.cos(T), 1e-3, 4))
    train, _ = settings.read_data()
    assert settings.simulation == {"y": "v_y", "z": "v_z"}
    assert train.filter is not None and {"v_y", "v_z"} <= {*train.derivative_names}


def test_a_position_alone_has_no_dictionary(here):
    settings = written("position alone", here)
    # Its terms would be learned in every explanation.
    assert not settings.dictionary


def test_runs_and_uneven_stamps_are_seen(here):
    settings = written("two levels", here)
    train, _ = settings.read_data()
    # Uneven stamps are not filtered: their rows are samples.
    assert train.run_names == ("a", "b") and train.filter is None
    assert list(for_fit(settings).build_model().dictionary) == ["level_1", "level_2"]
    # A study looks at one of them.
    assert settings.build_studied_model().equations == ("level_1",)


def test_runs_without_a_name_and_empty_cells_are_told(here):
    y = noisy(oscillator()[0], 1e-3, 0)
    y[7] = np.nan
    settings = written("position alone", here, t=np.tile(T[: N // 2], 2), y=y)
    assert (settings.data.restart, settings.data.missing) == ("run", "drop")
    assert "rows with empty cells are left out, 1 here" in settings.text


def test_what_cannot_be_written_is_refused(here, capsys):
    position_alone().to_csv(here / "run.csv", index=False)
    (here / "run.toml").write_text("# mine\n")
    assert "is there already; choose another name with --output" in refuse(capsys, "init", "run.csv")
    assert (here / "run.toml").read_text() == "# mine\n"
    assert "cannot be written" in refuse(capsys, "init", "run.csv", "-o", "no/folder/run.toml")
    pd.DataFrame({"t": T, "gain": 1.0}).to_csv(here / "flat.csv", index=False)
    assert "nothing to model" in refuse(capsys, "init", "flat.csv")
    assert "There is no file" in refuse(capsys, "init", "absent.csv")


@pytest.mark.slow
def test_the_draws_that_are_written_are_enough_with_room(here):
    settings = for_fit(written("measured rates", here))
    train, _ = settings.read_data()
    fit = settings.build_model().fit(train, **settings.sampling.model_dump(), progress=False)
    table = convergence_table(fit).query("varies")
    assert fit.verdict.ok and table[["ess_bulk", "ess_tail"]].to_numpy().min() > 2 * MIN_ESS


@pytest.mark.slow
@pytest.mark.parametrize("name", TABLES)
def test_what_is_written_runs(name, here):
    for_fit(written(name, here))
    words = ["--draws", "200", "--tune", "300", "--no-progress", "--quiet"]
    assert cli.main(["fit", "run.toml", "--output", "out", *words]) in (0, 3)
    fit = bg.load(here / "out" / "run.nc")
    table = fit.inclusion()
    if name != "two levels":
        # The truth is F - 4 y - 0.3 v.
        mean = table["mean"].to_numpy()
        np.testing.assert_allclose(np.sort(mean)[[0, 1, -1]], [-4.0, -0.3, 1.0], atol=0.1)


def test_a_german_file_is_no_file_of_words(here):
    table = position_alone().assign(y=lambda table: 1500.0 * table["y"], F=np.repeat([0.5, 1.5], N // 2))
    text = table.to_csv(index=False, sep=";", decimal=",", float_format="%.3f")
    lines = text.splitlines()
    cells = [line.split(";") for line in lines[1:]]
    for row in cells:
        whole, part = row[1].split(",")
        row[1] = f"{int(whole):,d}".replace(",", ".") + f",{part}" if abs(int(whole)) >= 1000 else row[1]
    (here / "run.csv").write_text("\n".join([lines[0], *map(";".join, cells)]))
    assert cli.main(["init", "run.csv"]) == 0
    settings = load_config(here / "run.toml")
    assert (settings.data.decimal, settings.data.thousands, settings.data.run) == (",", ".", None)
    assert settings.data.inputs == ["F"]
    read = bg.read(here / "run.csv", time="t", states=["y"], inputs=["F"], decimal=",", thousands=".")
    np.testing.assert_allclose(read.states["y"], table["y"], atol=5e-4)


TITLE = "Rig 4 - run 17;;"
GERMAN = {
    "title": f"{TITLE}\nt [ms];pos (mm);force_N",
    "title without marks": "Rig 4\nt [ms];pos (mm);force_N",
    "units": "t;pos;force_N\ns;mm;N",
    "title and units": f"{TITLE}\nt;pos;force_N\n[ms];[mm];[N]",
    "two titles": f"{TITLE}\nTuesday\nt [ms];pos (mm);force_N",
    "title and a gap at the start": f"{TITLE}\nt [ms];pos (mm);force_N\n-20;;0,5",
    "remark": "# Rig 4;;\nt [ms];pos (mm);force_N",
}


def german(folder, head, encoding="utf-8", gaps=True):
    """A table of a position with decimal commas and, with gaps, an empty cell and rows that lack."""
    y = 10 * oscillator()[0]
    cell = lambda i: "" if gaps and i == 7 else f"{y[i]:.3f}"  # noqa: E731
    rows = [f"{20 * i};{cell(i)};{FORCE[i]:.3f}" for i in range(N) if not (gaps and 100 < i < 150)]
    (folder / "run.csv").write_text("\n".join([head, *(row.replace(".", ",") for row in rows)]), encoding)


@pytest.mark.parametrize("head", GERMAN)
def test_titles_units_and_commas_are_found(head, here, capsys):
    german(here, GERMAN[head])
    assert cli.main(["init", "run.csv"]) == 0
    out = capsys.readouterr().out
    settings = load_config(here / "run.toml")
    train, _ = settings.read_data()
    assert (train.units["pos"], settings.data.decimal) == ("mm", ",")
    assert train.units["t"] == ("s" if head == "units" else "ms")
    assert "decimal commas" in out and " with empty cells" in out
    assert ("above the names" in out) == ("title" in head) and ("a row of units" in out) == ("units" in head)


def test_a_position_with_gaps_is_of_second_order_and_needs_one_line(here, capsys):
    german(here, GERMAN["title"])
    assert cli.main(["init", "run.csv"]) == 0
    out = capsys.readouterr().out
    assert "pos      state in mm, a position: its rate v is a state too" in out and "t        time in ms" in out
    assert "discover run.toml" in out and "fit run.toml" in out and 'v = "..."' in out
    settings = load_config(here / "run.toml")
    assert settings.study.catalogue == "mechanical"
    assert settings.simulation == {"pos": "v"} and not settings.dictionary and settings.data.differentiate is None
    # 2 kg, 30 N/m and 0.8 N s/m: a/(mm/ms²) = F/(2000 N) - 15e-6 pos/mm - 0.4e-3 v/(mm/ms).
    assert '"force_N/2000 - 1.5e-05*pos - 0.0004*v" (2 kg, 30 N/m, 0.8 N s/m in mm, ms, N)' in settings.text
    # The unit of the force is asked for; newtons are supposed, and said.
    assert '# force_N = "N"  # unit of force_N, if its name says so' in settings.text
    assert "add a line v = " in refuse(capsys, "discover", "run.toml")
    text = re.sub('^# v = ".*$', 'v = "force_N/2000 - 4e-6*pos - 3e-4*v"', settings.text, flags=re.MULTILINE)
    (here / "run.toml").write_text(text, encoding="utf-8")
    ready = load_config(here / "run.toml")
    train, _ = ready.read_data()
    model = ready.build_studied_model().on(train)
    assert studied_equations(model, train) == ("v",)


def test_text_of_windows_is_read(here, capsys):
    german(here, "t [s];T_in [°C];T_amb [°C]", "cp1252", gaps=False)
    assert cli.main(["init", "run.csv"]) == 0
    settings = load_config(here / "run.toml")
    assert "text in cp1252" in capsys.readouterr().out and settings.data.encoding == "cp1252"
    # A temperature is no position, and what is around acts from outside.
    assert (settings.data.states, settings.data.inputs, settings.simulation) == (["T_in"], ["T_amb"], {})


def test_a_level_is_no_position_and_dates_are_seconds(here):
    days = pd.date_range("2024-03-14", periods=N, freq="s").strftime("%Y-%m-%d %H:%M:%S")
    pd.DataFrame({"day": days, "level1 [cm]": oscillator()[0], "pump": FORCE}).to_csv(here / "run.csv", index=False)
    assert cli.main(["init", "run.csv"]) == 0
    settings = load_config(here / "run.toml")
    assert settings.simulation == {} and settings.data.units == {"t": "s", "level1": "cm"}
    assert settings.study.catalogue == "fluid"


def test_dates_that_cannot_be_told_are_asked_for(here, capsys):
    days = pd.date_range("2024-03-04", periods=8)
    pd.DataFrame({"day": days.strftime("%d/%m/%Y"), "y": np.arange(8.0) ** 2}).to_csv(here / "run.csv", index=False)
    assert "pass --dayfirst or --monthfirst" in refuse(capsys, "init", "run.csv")
    assert cli.main(["init", "run.csv", "--dayfirst"]) == 0
    settings = load_config(here / "run.toml")
    assert (settings.data.time, settings.data.dayfirst) == ("day", True)
