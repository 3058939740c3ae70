"""A fleet of studies from the shell and from Python: assets and their results."""

import json
import re
from functools import partial, wraps

import numpy as np
import pandas as pd
import pytest
from pumps import CATALOGUE, CONFIG, pumps

import bayes_greybox as bg
from bayes_greybox.cli import main
from bayes_greybox.fleet.assets import assets_of
from bayes_greybox.fleet.run import _mark, _studied, study_fleet
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.tasks import SCHEDULER_LOST, Done


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    """Three pumps, of which one lacks nothing, and a file that is none; studied one after another."""
    folder = pumps(tmp_path_factory.mktemp("fleet"))
    (folder / "pumps" / "bad <b>.csv").write_text("t,y\n0,x\n", encoding="utf-8")
    code = main(["discover", str(folder / "all.toml"), "--fleet", str(folder / "pumps"), "-o", str(folder / "out"),
                 "--workers", "1", "-q"])  # fmt: skip
    assert code == 0
    return folder


def test_assets_are_ranked_and_say_one_cause(fleet):
    record = json.loads((fleet / "out" / "summary.json").read_text(encoding="utf-8"))
    assert [row["verdict"] for row in record["assets"]][2:] == ["no gap", "failed"]
    assert {row["lacks"] for row in record["assets"][:2]} == {"Cubic stiffness"}
    assert "2 of 3 assets lack cubic stiffness" in record["sentence"] and "1 of 4 files" in record["sentence"]
    (shared,) = record["shared"]
    assert shared["assets"] == ["pump 0", "pump 2"] and abs(shared["whole"]["mean"] + 42) < 8
    table = pd.read_csv(fleet / "out" / "assets.csv", index_col="asset")
    assert list(table.index)[-1] == "bad <b>" and "correct the cell" in table.loc["bad <b>", "sentence"]


def test_its_page_leads_to_those_of_the_assets_and_escapes_their_names(fleet):
    page = (fleet / "out" / "fleet.html").read_text(encoding="utf-8")
    assert "bad &lt;b&gt;" in page and "bad <b>" not in page
    # Assets that lack too little of it to be found are not in the mean.
    assert "of the assets that lack it" in page and "mean of the fleet" not in page
    links = re.findall(r'href="(assets/[^"]+)"', page)
    assert len(links) == 3 and "assets/pump%200/gap.html" in links
    assert all((fleet / "out" / link.replace("%20", " ")).is_file() for link in links)


def test_its_page_can_be_read_on_a_phone(fleet):
    page = (fleet / "out" / "fleet.html").read_text(encoding="utf-8")
    # Coefficients are drawn once more, narrow, and sentences do not become a tower of single words.
    assert page.count('<div class="narrow"><svg') == 1
    assert '<td class="sentence">The simulation lacks cubic stiffness' in page
    assert "coefficient of y³" in page and "user units" not in page


@pytest.mark.slow
def test_two_workers_give_the_same(fleet, tmp_path):
    folder = tmp_path / "together"
    assert main(["discover", str(fleet / "all.toml"), "--fleet", str(fleet / "pumps"), "-o", str(folder),
                 "--workers", "2", "-q"]) == 0  # fmt: skip
    for name in ("pump 0", "pump 1", "pump 2"):
        one, other = (
            json.loads((place / "assets" / name / "summary.json").read_text(encoding="utf-8"))
            for place in (folder, fleet / "out")
        )
        for record in (one, other):
            del record["settings"]["seconds"]
        assert one == other


def test_what_was_studied_is_not_studied_again(fleet, monkeypatch, capsys):
    monkeypatch.setattr("bayes_greybox.fleet.run.find_missing_effects", lambda *_, **__: pytest.fail("studied again"))
    before = (fleet / "out" / "summary.json").read_text(encoding="utf-8")
    assert main(["discover", str(fleet / "all.toml"), "--fleet", str(fleet / "pumps"), "-o", str(fleet / "out"),
                 "--workers", "1"]) == 0  # fmt: skip
    assert (fleet / "out" / "summary.json").read_text(encoding="utf-8") == before
    assert "pump 2" in capsys.readouterr().out


def test_results_of_other_settings_or_catalogues_are_not_taken_for_these(fleet, tmp_path):
    asset = assets_of(fleet / "pumps", fleet / "all.toml")[1]
    own = fleet / "out" / "assets" / asset.name
    mark = _mark(asset, {})
    assert _studied(own, mark) is not None
    # The seed that the file has anyway is no other one.
    assert _mark(asset, {"seed": 0}) == mark != _mark(asset, {"seed": 1})
    catalogue = (fleet / "few.toml").read_text(encoding="utf-8")
    (fleet / "few.toml").write_text(catalogue + "\n", encoding="utf-8")
    assert _mark(asset, {}) != mark
    (fleet / "few.toml").write_text(catalogue, encoding="utf-8")
    # A record that another run wrote there.
    text = (own / "summary.json").read_text(encoding="utf-8")
    (own / "summary.json").write_text(text.replace("named", "unknown"), encoding="utf-8")
    assert _studied(own, mark) is None
    (own / "summary.json").write_text(text, encoding="utf-8")


def test_mistakes_of_the_configuration_are_no_assets_fault(fleet, tmp_path):
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(CONFIG.replace("test_fraction = 0.3", '[data.test]\npath = "x.csv"'), encoding="utf-8")
    with pytest.raises(InputError, match="test_fraction"):
        assets_of(fleet / "pumps", wrong)
    assert main(["discover", str(fleet / "all.toml"), "--fleet", str(fleet / "pumps"), "-o", str(fleet / "pumps")]) == 2
    assert main(["report", str(fleet / "out")]) == 2


def test_a_copy_of_an_assets_configuration_reads_its_data(fleet):
    from bayes_greybox.config import load_config

    own = fleet / "out" / "assets" / "pump 2"
    settings = load_config(own / "config.toml")
    train, _ = settings.read_data()
    measured = pd.read_csv(fleet / "pumps" / "pump 2.csv")["y"].to_numpy()
    np.testing.assert_array_equal(train.column("y"), measured[: train.n_obs])
    assert settings.text == CONFIG and settings.folder == own


def test_folders_without_assets_are_refused(tmp_path, fleet):
    with pytest.raises(InputError, match="no folder"):
        assets_of(tmp_path / "none", None)
    with pytest.raises(InputError, match="no configuration files"):
        assets_of(fleet / "pumps", None)
    (tmp_path / "a.csv").touch()
    (tmp_path / "a.txt").touch()
    (tmp_path / "readme.md").touch()
    with pytest.raises(InputError, match="two files that are called 'a':"):
        assets_of(tmp_path, fleet / "all.toml")
    (tmp_path / "a.txt").rename(tmp_path / "A.txt")
    with pytest.raises(InputError, match="two files that are called 'A' and 'a':"):
        assets_of(tmp_path, fleet / "all.toml")
    assert main(["discover", "--workers", "2"]) == 2
    assert main(["discover", str(fleet / "all.toml"), "--fleet", str(fleet / "pumps"), "--resume"]) == 2
    assert main(["discover", str(fleet / "all.toml"), "--workers", "2"]) == 2


MODEL = bg.GreyBox(
    simulation={"y": "ydot", "ydot": "F - 10*y - 0.5*ydot"}, discrepancy=bg.OrthogonalGP(variables=["y"])
)
"""That of `CONFIG`."""

DATA = bg.systems.duffing().simulate(t=np.linspace(0, 1, 9), seed=0)


@pytest.fixture(scope="module")
def worker():
    """A Dask scheduler with one worker, to which things go by TCP, as to another machine; both are in this process."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp://", dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="module")
def from_python(fleet, worker):
    """Two of the pumps, a file that is none and a model that does not fit its data, without a configuration."""
    files = {name: fleet / "pumps" / f"{name}.csv" for name in ("pump 0", "pump 2")}
    files["bad"] = fleet / "pumps" / "bad <b>.csv"
    read = partial(bg.read, time="t", states=["y", "ydot"], inputs=["F"], derivatives={"ydot": "a"})
    wrong = bg.GreyBox(simulation={"y": "ydot", "ydot": "F - 10*q"})
    return bg.find_missing_effects_of_fleet(
        {**dict.fromkeys(files, MODEL), "wrong": wrong}, {**files, "wrong": read(files["pump 0"])}, test=0.3, read=read,
        catalogue=str(fleet / "few.toml"), settle=False, free_runs=False, scheduler=worker, progress=False,
    )  # fmt: skip


def test_python_tells_assets_and_their_pooled_coefficient(from_python):
    assert set(from_python.studies) == {"pump 0", "pump 2"}
    assert "2 of 2 assets lack cubic stiffness" in from_python.sentence and from_python.sentence in repr(from_python)
    (row,) = from_python.coefficients.itertuples()
    assert row.Index == ("ydot", "cubic-stiffness", "y**3") and row.assets == ("pump 0", "pump 2")
    assert row.lower < -42 < row.upper and abs(row.mean + 42) < 8 and 0 < row.same < 1
    own = from_python.by_asset.xs("pump 2", level="asset").iloc[0]
    # Drawn towards the other one.
    assert min(row.mean, own["mean"]) < own["pooled_mean"] < max(row.mean, own["mean"])
    assert own["mean"] == from_python.studies["pump 2"].effects.iloc[0]["mean"]


def test_from_python_too_an_asset_fails_with_its_reason_and_nothing_else(from_python):
    assert list(from_python.failed) == ["bad", "wrong"]
    assert "correct the cell" in from_python.failed["bad"] and "'q'" in from_python.failed["wrong"]
    assert list(from_python.assets["verdict"])[2:] == ["failed", "failed"]
    assert "wrong could not be studied" in repr(from_python)


def test_python_says_and_writes_what_the_command_does(from_python, fleet, tmp_path):
    from_python.save(tmp_path, progress=False)
    tables = [
        pd.read_csv(place / "assets.csv", index_col="asset").rename({"bad <b>": "bad"})
        for place in (tmp_path, fleet / "out")
    ]
    names = ["pump 0", "pump 2", "bad"]
    pd.testing.assert_frame_equal(*(table.loc[names] for table in tables), check_exact=True)
    for own in ("", "assets/pump 0", "assets/pump 2"):
        one, other = (
            json.loads((place / own / "summary.json").read_text(encoding="utf-8"))
            for place in (tmp_path, fleet / "out")
        )
        if not own:
            assert one["shared"] == other["shared"]
            continue
        sampling, asked = one.pop("sampling"), other.pop("sampling")
        # The configuration says more than the sampler's settings, and names itself.
        assert sampling and sampling.items() <= asked.items()
        for record in (one, other):
            record.pop("config", None)
            for key in ("seconds", "catalogue", "name", "configuration"):
                record["settings"].pop(key, None)
        assert one == other
    links = re.findall(r'href="(assets/[^"]+)"', (tmp_path / "fleet.html").read_text(encoding="utf-8"))
    assert len(links) == 2 and all((tmp_path / link.replace("%20", " ")).is_file() for link in links)
    assert bg.load(tmp_path / "assets" / "pump 2" / "study.nc").verdict == "named"


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"train": {}}, "needs an asset"),
        ({"train": {"a/b": "a.csv"}}, "cannot be a folder's"),
        ({"train": {"inlet: 1": "a.csv"}}, "cannot be a folder's"),
        ({"train": {"a" * 256: "a.csv"}}, "too long"),
        ({"train": {"Pump": "a.csv", "pump": "b.csv"}}, "'Pump' and 'pump' are one folder"),
        ({"train": DATA}, r"give data by asset, such as train=\{'pump 1': data\}"),
        ({"train": {"a": pd.DataFrame()}}, "train has DataFrame for 'a'"),
        ({"train": {"a": "a.csv"}, "model": "duffing"}, "The model of 'a' is str"),
        ({"train": {"a": DATA}, "test": DATA}, r"give data by asset, such as test=\{'pump 1': data\}"),
        ({"train": {"a": DATA}, "test": "held_out/"}, r"give data by asset, such as test=\{'pump 1': data\}"),
        ({"train": {"a": DATA}, "test": {"a": 0.3}}, "test has float for 'a'"),
        ({"train": {"a": DATA}, "catalogue": "mechancal"}, "did you mean 'mechanical'"),
        ({"train": {"a": DATA}, "draws": 0}, "draws=0"),
        ({"train": {"a": DATA}, "chains": "four"}, "chains='four' must be a whole number"),
        ({"train": {"a": DATA}, "seed": -1}, "seed=-1"),
        ({"train": {"a": DATA}, "effects_at_most": 0}, "effects_at_most=0"),
        ({"train": {"a": DATA}, "catalog": "fluid"}, "did you mean 'catalogue'"),
        ({"train": {"a": "a.csv"}, "model": {"b": MODEL}}, "no model for 'a'"),
        ({"train": {"a": "a.csv"}, "test": {"b": "a.csv"}}, "which is no asset"),
        ({"train": {"a": "a.csv"}, "test": 1.5}, "no share"),
        ({"train": {"a": "a.csv"}, "checkpoint": "x"}, "There is no setting 'checkpoint'"),
        ({"train": "nowhere"}, "no folder"),
    ],
)
def test_what_no_fleet_can_be_made_of_is_refused(given, sentence):
    with pytest.raises(InputError, match=sentence):
        bg.find_missing_effects_of_fleet(**{"model": MODEL, "workers": 1, "progress": False, **given})


@pytest.fixture
def asked(monkeypatch):
    """What studies were asked for: measurements, held-out data and settings by asset, none of which is studied."""
    found = []

    @wraps(bg.find_missing_effects)
    def none(model, train, test, **settings):
        found.append((train, test, settings))
        raise InputError("Not studied.")

    monkeypatch.setattr("bayes_greybox.fleet.studies.find_missing_effects", none)
    return found


def test_a_share_or_data_of_some_assets_are_held_out(asked):
    bg.find_missing_effects_of_fleet(MODEL, {"a": DATA}, test=1 / 3, progress=False)
    bg.find_missing_effects_of_fleet(MODEL, {"a": DATA, "b": DATA}, {"b": DATA}, progress=False)
    (share, late, _), (_, none, _), (_, own, _) = asked
    assert (share.n_obs, late.n_obs) == (6, 3)
    np.testing.assert_array_equal(late.column("y"), DATA.column("y")[6:])
    assert none is None and own is DATA


def test_paths_hold_in_another_working_folder(asked, tmp_path, monkeypatch):
    (tmp_path / "few.toml").write_text(CATALOGUE, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    read = []
    bg.find_missing_effects_of_fleet(
        MODEL, {"a": "a.csv"}, {"a": "later.csv"}, read=lambda path: read.append(path) or DATA,
        catalogue=["fluid", "few.toml"], progress=False,
    )  # fmt: skip
    assert read == [tmp_path / "a.csv", tmp_path / "later.csv"]
    assert asked[0][2]["catalogue"] == ["fluid", str(tmp_path / "few.toml")]


def test_a_lost_scheduler_costs_python_what_was_not_done_and_the_command_its_end(fleet, tmp_path, monkeypatch):
    asked = []

    def lost(function, tasks, **where):
        asked.append(where)
        yield from (Done(name, failed=SCHEDULER_LOST) for name in tasks)

    monkeypatch.setattr("bayes_greybox.fleet.reporting.run_tasks", lost)
    for where in ({"scheduler": "tcp://any:1"}, {"workers": 2}):
        found = bg.find_missing_effects_of_fleet(MODEL, {"a": DATA}, **where, progress=False)
        assert found.failed == {"a": SCHEDULER_LOST} and where.items() <= asked[-1].items()
    assets = assets_of(fleet / "pumps", fleet / "all.toml")
    with pytest.raises(InputError, match="What is done is kept: give the same command again"):
        study_fleet(assets, tmp_path / "out", {}, scheduler="tcp://any:1", progress=False)


def test_folders_that_cannot_be_made_are_refused_in_a_sentence(from_python, tmp_path):
    (tmp_path / "assets").write_text("", encoding="utf-8")
    with pytest.raises(InputError, match="Cannot write to the folder"):
        from_python.save(tmp_path, progress=False)
