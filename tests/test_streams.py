"""A fit of a stream: the posterior of all rows, with a sample of them looked at one by one, saved and loaded."""

import json
import os

import h5py
import numpy as np
import pytest
from fabricated import fabricate
from streamed import NAMES, chunk, chunks, frame, model, together

import bayes_greybox as bg
from bayes_greybox.cli import main
from bayes_greybox.criticism.cross_validation.row_densities import pointwise_loo
from bayes_greybox.data.streams.row_stream import RowStream
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.running.errors import InputError

FEW = {"draws": 40, "tune": 60, "chains": 2, "progress": False}


# Where types are checked they refuse it first.
UNREAD = Exception if os.environ.get("BAYES_GREYBOX_TYPECHECK") == "1" else InputError


def _own(**further):
    return model(discrepancy=bg.OrthogonalGP(variables=("y",), features=6), prior=bg.Normal(), **further)


@pytest.fixture(scope="module")
def fit():
    return _own().fit(chunks(sample=300), **FEW)


def test_it_says_how_many_rows_there_are_and_how_many_are_looked_at(fit):
    assert fit.n_obs == 20_000 and fit.data.n_obs == 300
    assert "20,000 rows (measured rates), of which 300 are looked at one by one" in repr(fit)
    assert "20,000 rows of chunks of a function were read in chunks" in repr(fit.data)


def test_left_out_rows_of_the_sample_are_predicted_from_all_the_others(fit):
    whole = Posterior(fit.model, together(), fit.sampling, fit.idata)
    # Stretches of the sample are known by their values.
    row = [int(np.flatnonzero(whole.data.states["y"] == value)[0]) for value in fit.data.states["y"]]
    np.testing.assert_allclose(pointwise_loo(fit, "ydot"), pointwise_loo(whole, "ydot")[:, row], atol=1e-7)


def test_checks_tables_and_predictions_are_made(fit):
    assert set(fit.checks().table.index.get_level_values("check")) >= {"LOO-PIT", "whiteness"}
    assert fit.discrepancy().loc["ydot", "dictionary"] == pytest.approx(1.0, abs=0.01)
    assert fit.predict(bg.read(frame(200, seed=99), **NAMES)).nmse()["ydot"] < 0.01
    assert set(fit.idata.children) >= {"log_likelihood", "posterior_predictive"}


@pytest.mark.slow
def test_its_posterior_is_that_of_the_same_rows_in_memory(fit):
    same = _own().fit(together(), **FEW)
    got, expected = (each.summary().loc["ydot"].loc[["y**3", "ydot**3", "sigma"]] for each in (fit, same))
    # Within five Monte Carlo standard errors of as few draws as 80; false failures under 1e-5.
    assert np.all(np.abs(got["mean"] - expected["mean"]) < 5 * expected["sd"] * np.sqrt(2 / 80))
    np.testing.assert_allclose(got["sd"], expected["sd"], rtol=0.6)


def test_its_file_holds_what_all_rows_say(fit, tmp_path):
    fit.save(tmp_path / "fit.nc")
    again = bg.load(tmp_path / "fit.nc")
    assert again.n_obs == 20_000 and repr(again) == repr(fit)
    for name in ("Phi", "Psi", "y", "noise_floor"):
        mine, theirs = (np.asarray(getattr(each.equations["ydot"].design, name)) for each in (fit, again))
        np.testing.assert_array_equal(mine, theirs)
    again.save(tmp_path / "again.nc")
    assert bg.load(tmp_path / "again.nc").whole["ydot"].digest == fit.whole["ydot"].digest
    fit.to_html(tmp_path / "fit.html")
    assert "20,000 rows (measured rates), of which 300" in (tmp_path / "fit.html").read_text(encoding="utf-8")


def test_a_file_that_lacks_them_is_refused(fit, tmp_path):
    path = tmp_path / "fit.nc"
    fit.save(path)
    with h5py.File(path, "a") as file:
        del file["row_statistics/ydot_factor"]
    with pytest.raises(InputError, match=r"fit.nc.*damaged"):
        bg.load(path)


def test_what_needs_all_rows_at_once_says_what_to_do(fit):
    with pytest.raises(InputError, match="Leaving rows out needs all of them again.*scheme='loo' with max_refits=0"):
        bg.cross_validate(fit, scheme="future")
    for call in (
        lambda: bg.find_missing_effects(_own(), chunks()),
        lambda: bg.compare_priors(_own(), chunks()),
        lambda: _own().assemble(chunks()),
    ):
        with pytest.raises(UNREAD, match=r"stream\.sample|RowStream"):
            call()
    with pytest.raises(InputError, match="noise"):
        _own(noise=bg.Noise(tails="fit")).fit(chunks(), **FEW)
    with pytest.raises(InputError, match="path='hsgp'"):
        model(discrepancy=bg.OrthogonalGP(path="exact")).fit(chunks(), **FEW)


def test_what_is_wrong_with_the_rows_is_said_as_in_memory():
    def still(i):
        data = chunk(i)
        return bg.Trajectories.from_arrays(
            data.time, states={"y": 0 * data.time + 2, "ydot": data.states["ydot"]},
            derivatives={"ydot": data.rate("ydot")}, constant="keep",
        )  # fmt: skip

    with pytest.raises(InputError, match='"y" is constant'):
        _own().fit(RowStream.from_chunks(still, 2), **FEW)
    logs = bg.GreyBox(dictionary={"ydot": ["y", "log(y)"]}, discrepancy=None)
    with np.errstate(invalid="ignore"), pytest.raises(InputError, match=r"log\(y\).*not finite on all the data"):
        logs.fit(chunks(), **FEW)
    twice = bg.GreyBox(dictionary={"ydot": ["y", bg.Term("2*y", name="double")]}, discrepancy=None)
    with pytest.raises(InputError, match="double"):
        twice.fit(chunks(), **FEW)


def _units(i):
    """Chunks of which one that is not in the sample has another unit."""
    return bg.read(frame(100, seed=i).rename(columns={"y": "y [mm]" if i == 3 else "y [m]"}), **NAMES)


def test_rows_that_do_not_go_together_or_are_others_when_read_again_are_refused():
    asked = np.random.default_rng(0)
    once = (chunk(i) for i in range(10))
    for function, words in (
        (_units, "unit of y is m in the sample .* but mm in part 3: convert one"),
        (
            lambda i: bg.read(frame(100, seed=int(asked.integers(10**9))), **NAMES),
            "others when they were read again.*seed",
        ),
        (lambda i: next(once), "ran out of rows.*iterator"),
    ):
        with pytest.raises(InputError, match=words):
            _own().fit(RowStream.from_chunks(function, 40, sample=50), **FEW)


def test_it_is_not_compared_with_a_fit_of_its_sample_alone(fit):
    with pytest.raises(InputError, match="20,000 rows, of which some are looked at, against 300"):
        bg.compare({"all": fit, "some": fabricate(_own(), fit.data)})


def test_chains_of_other_rows_do_not_go_on(tmp_path, monkeypatch):
    class Stop(Exception):
        pass

    def stopped(_):
        raise Stop

    def rows(changed):
        def other(i):
            data = chunk(i)
            # Of a row that is not in the sample.
            data.derivatives["ydot"][7] += 1e-3 * (i == 3 and changed)
            return data

        return RowStream.from_chunks(other, 5, sample=100)

    assert np.array_equal(rows(False).sample.rate("ydot"), rows(True).sample.rate("ydot"))
    monkeypatch.setattr(bg.Fit, "_complete", stopped)
    with pytest.raises(Stop):
        _own().fit(rows(False), **FEW, checkpoint=tmp_path / "kept")
    with pytest.raises(InputError, match="all rows"):
        _own().fit(rows(True), **FEW, checkpoint=tmp_path / "kept", resume=True)
    with pytest.raises(Stop):
        _own().fit(rows(False), **FEW, checkpoint=tmp_path / "kept", resume=True)


CONFIG = """
[data]
path = "rows.parquet"
stream = true
sample = 200
time = "t"
states = ["y", "ydot"]
derivatives = { ydot = "a" }
test = { path = "held_out.csv" }

[dictionary]
ydot = ["y", "ydot", "y**3", "ydot**3"]

[prior]
kind = "normal"

[discrepancy]
variables = ["y"]
features = 6

[sampling]
draws = 40
tune = 60
chains = 2

[output]
figures = false
"""


def test_from_the_shell(tmp_path, capsys):
    frame(5000).to_parquet(tmp_path / "rows.parquet", row_group_size=1000)
    frame(300, seed=5).to_csv(tmp_path / "held_out.csv", index=False)
    (tmp_path / "run.toml").write_text(CONFIG, encoding="utf-8")
    main(["fit", str(tmp_path / "run.toml"), "-o", str(tmp_path / "out"), "--no-progress"])
    assert "5,000 rows (measured rates), of which 200 are looked at one by one" in capsys.readouterr().out
    record = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert record["data"]["rows"] == 5000 and record["data"]["looked_at"] == 200
    assert record["held_out_nmse"]["ydot"] < 0.01
    for command in ("discover", "compare"):
        text = CONFIG + '[models.a]\n[models.b]\nprior = { kind = "normal" }\n'
        (tmp_path / "run.toml").write_text(text, encoding="utf-8")
        assert main([command, str(tmp_path / "run.toml"), "-o", str(tmp_path / command), "-q"]) == 2
        assert "GreyBox.fit alone reads a bg.stream" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("instead", "words"),
    [
        ("stream = true\ntest_fraction = 0.2", "not split"),
        ('stream = true\nrates = { y = "v" }', "rates does not apply"),
        ("sample = 100", "stream = true with it"),
        ('stream = true\nworkers = 2\nscheduler = "tcp://h:1"', "not both"),
    ],
)
def test_keys_that_do_not_go_together(tmp_path, instead, words):
    text = CONFIG.replace("stream = true\nsample = 200", instead).replace('test = { path = "held_out.csv" }\n', "")
    (tmp_path / "run.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=words):
        from bayes_greybox.config import load_config

        load_config(tmp_path / "run.toml")
