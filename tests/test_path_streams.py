"""A fit of a stream of runs: the posterior of all samples of paths, with some whole runs looked at one by one."""

import json

import numpy as np
import pytest
from streamed_runs import animals, oscillations, path_of, stream_of, weak

import bayes_greybox as bg
from bayes_greybox.cli import main
from bayes_greybox.criticism.cross_validation.row_densities import pointwise_loo
from bayes_greybox.greybox import Fit
from bayes_greybox.running.errors import InputError

FEW = {"draws": 40, "tune": 60, "chains": 2, "progress": False}


@pytest.fixture(scope="module")
def fit():
    """Of a sample of some runs."""
    return weak(prior=bg.Normal()).fit(stream_of(animals(), sample=200), **FEW)


def test_it_says_how_many_samples_there_are_and_how_many_are_looked_at(fit):
    assert fit.n_obs == animals().n_obs > fit.data.n_obs == fit.data.samples.n_obs
    words = f"{fit.n_obs} rows (integrals of x, y with test functions), of which {fit.data.n_obs} are looked at"
    assert words in repr(fit) and "whole runs" in repr(fit.data)
    assert "in the sample: test functions" in repr(fit) and "say nothing" not in repr(fit.data)
    assert set(fit.idata.children) >= {"log_likelihood", "posterior_predictive"}
    assert set(fit.checks().table.index.get_level_values("check")) >= {"LOO-PIT", "whiteness"}


@pytest.mark.slow
@pytest.mark.parametrize("make", [weak, path_of])
def test_its_posterior_is_that_of_the_same_runs_in_memory(make):
    runs = animals() if make is weak else oscillations()
    streamed, memory = (make(prior=bg.Normal()).fit(data, **FEW) for data in (stream_of(runs), runs))
    assert streamed.model.rows == memory.model.rows
    # The same chains, on sums that differ by their rounding.
    got, expected = (each.summary()[["mean", "sd"]].to_numpy() for each in (streamed, memory))
    np.testing.assert_allclose(got, expected, rtol=1e-6)
    (block,) = streamed.equations
    np.testing.assert_allclose(pointwise_loo(streamed, block), pointwise_loo(memory, block), atol=1e-5)


def test_its_file_holds_what_all_runs_say(fit, tmp_path):
    fit.save(tmp_path / "fit.nc")
    again = bg.load(tmp_path / "fit.nc")
    assert again.n_obs == fit.n_obs and repr(again) == repr(fit)
    for name in ("Phi", "y", "log_det_R", "n_obs"):
        mine, theirs = (np.asarray(getattr(each.equations["x_and_y"].design, name)) for each in (fit, again))
        np.testing.assert_array_equal(mine, theirs)
    assert again.whole["x_and_y"].digest == fit.whole["x_and_y"].digest
    np.testing.assert_array_equal(again.whole["x_and_y"].plain, fit.whole["x_and_y"].plain)


def test_what_needs_all_runs_at_once_says_what_to_do(fit):
    with pytest.raises(InputError, match="Leaving rows out needs all of them again"):
        bg.cross_validate(fit, scheme="trajectory")
    with pytest.raises(InputError, match=r"GreyBox\(noise=Noise\(...\)\) is found on the residuals of all rows"):
        path_of(noise=bg.Noise(correlation="fit")).fit(stream_of(oscillations()), **FEW)
    with pytest.raises(InputError, match="path='hsgp'"):
        path_of(discrepancy=bg.OrthogonalGP(path="exact")).fit(stream_of(oscillations()), **FEW)
    with pytest.raises(InputError, match=r"Fit\.refine follows the exact path of every run.*fit\.data\.samples"):
        Fit(*path_of().near(oscillations()), fit.sampling, fit.idata, whole=fit.whole).refine(draws=5)
    with pytest.raises(InputError, match="GreyBox.fit alone reads"):
        bg.find_missing_effects(weak(), stream_of(animals()))


def test_a_run_with_too_few_samples_is_refused_as_in_memory():
    data = oscillations()
    with pytest.raises(InputError, match="has 4 samples, too few for a path of 2 states"):
        path_of().fit(bg.RowStream.from_chunks(lambda i: data.take(i).keep(slice(0, 4 if i == 2 else 120)), 4), **FEW)


CONFIG = """
[data]
path = "*.parquet"
stream = true
sample = 200
time = "t"
run = "id"
states = ["x", "y"]

[rows]
kind = "weak"

[dictionary]
x = ["x", "x*y"]
y = ["x*y", "y"]

[prior]
kind = "normal"

[discrepancy]
enabled = false

[sampling]
draws = 40
tune = 60
chains = 2

[output]
figures = false
"""


def test_from_the_shell(tmp_path, capsys):
    data = animals()
    frame = data.to_frame().rename(columns={"run": "id"})
    frame[frame["id"] < 3].to_parquet(tmp_path / "a.parquet", row_group_size=70)
    frame[frame["id"] >= 3].to_parquet(tmp_path / "b.parquet", row_group_size=70)
    (tmp_path / "run.toml").write_text(CONFIG, encoding="utf-8")
    main(["fit", str(tmp_path / "run.toml"), "-o", str(tmp_path / "out"), "--no-progress"])
    assert f"{data.n_obs} rows (integrals of x, y with test functions), of which" in capsys.readouterr().out
    record = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert record["data"]["rows"] == data.n_obs and 200 <= record["data"]["looked_at"] < data.n_obs
