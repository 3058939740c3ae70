"""Files of an older version open, say what they said there, and can be saved again; see tests/data/files/README.md."""

import dataclasses
import gzip
import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import bayes_greybox as bg
from bayes_greybox.inference.kept.model_record import describe, rebuild
from bayes_greybox.model.rows.derivative_rows import DerivativeRows

FILES = Path(__file__).parents[2] / "data" / "files"

SAID = {
    "fit": {
        "inclusion": [1.0, 0.009340696542944922, 0.006022634804129001],
        "mean": [-0.20007277516704464, 0.0, 0.0],
        "loo": 91.85588981511115,
        "block": 88.6674854182622,
        "nmse": 0.0009329578077234503,
        "noise": 0.0008082247794516384,
        "sensitivity": [0.04920062429963353, 0.1463312589279885],
    },
    "study": {
        "inclusion": [1.0, 1.0, 0.6289636173701187],
        "mean": [-9.222085416508786, 0.24438955119597483, -0.6164413604355239],
        "loo": -2.2840135790310043,
        "block": -4.2434237394204395,
        "nmse": 0.00016625053664530816,
        "noise": 0.0001533346304685157,
        "sensitivity": [0.09272520744913926, 0.5648251512819035],
    },
}
"""What commit ef3be5d said of its files."""


@pytest.fixture(scope="module", params=list(SAID))
def name(request):
    return request.param


@pytest.fixture(scope="module")
def fit(name, tmp_path_factory):
    return bg.load(write(name, tmp_path_factory.mktemp("older")))


def write(name, folder):
    path = folder / f"{name}.nc"
    path.write_bytes(gzip.decompress((FILES / f"{name}.nc.gz").read_bytes()))
    return path


def test_the_tables_say_what_they_said(name, fit):
    said = SAID[name]
    np.testing.assert_allclose(fit.inclusion()["inclusion"], said["inclusion"], rtol=1e-9)
    np.testing.assert_allclose(fit.inclusion()["mean"], said["mean"], rtol=1e-9)
    assert fit.predict(fit.data).nmse()["ydot"] == pytest.approx(said["nmse"], rel=1e-6)
    assert fit.discrepancy()["noise"].iloc[0] == pytest.approx(said["noise"], rel=1e-6)
    assert not fit.verdict.ok and "converged" in str(fit.checks())
    sensitivity = fit.sensitivity().select_dtypes("number").iloc[0]
    np.testing.assert_allclose(sensitivity, said["sensitivity"], rtol=1e-6)
    for scheme, settings in (("loo", {}), ("block", {"block": 5})):
        # Without the refits that so few draws ask for.
        found = bg.cross_validate(fit, scheme, refit=None, progress=False, **settings)
        assert found.elpd == pytest.approx(said[scheme], rel=1e-6)


def test_the_parts_of_the_model_are_there(name, fit):
    assert fit.model.rows == DerivativeRows()
    assert fit.model.prior == bg.SpikeAndSlab()
    # Rows with correlated noise had no weights.
    differs = {"variables": ("y",), "measure": "unweighted"} if name == "fit" else {}
    assert fit.model.discrepancy == bg.OrthogonalGP(features=4, **differs)
    assert fit.model.simulation["y"] == "ydot"
    assert fit.data.units["y"] == "m"
    # Filtered rates have the noise of their rows.
    assert ("ydot" in fit.data.noise) == (name == "fit")
    assert fit.sampling.draws == 25


def test_a_boundary_for_each_variable_survives_a_file(fit):
    gp = bg.OrthogonalGP(variables=("y", "ydot"), boundary=(2.0, 4.8), features=4)
    model = dataclasses.replace(fit.model, discrepancy=gp)
    assert rebuild(json.loads(json.dumps(describe(model, fit.data)))).discrepancy == gp


def test_their_details_are_put_apart_as_those_of_new_fits(name, fit, tmp_path):
    moved = {"ydot_weight", "ydot_prior_sd", "ydot_gamma", "ydot_inclusion"}
    with xr.open_datatree(write(name, tmp_path), engine="h5netcdf") as file:
        assert moved <= set(file["posterior"]) and "posterior_details" not in file.children
        held = {variable: file["posterior"][variable].load() for variable in file["posterior"]}
    assert set(fit.idata["posterior_details"]) == moved
    assert set(fit.idata["posterior"]) == set(held) - moved
    for variable, values in held.items():
        np.testing.assert_array_equal(fit.drawn()[variable], values)


def test_saved_again_it_is_the_same(name, fit, tmp_path):
    fit.save(tmp_path / "again.nc")
    again = bg.load(tmp_path / "again.nc")
    assert again.model == fit.model and again.sampling == fit.sampling
    assert again.data.metadata() == fit.data.metadata()
    assert list(again.idata.children) == list(fit.idata.children)
    for group in fit.idata.children:
        xr.testing.assert_identical(again.idata[group].dataset, fit.idata[group].dataset)
    if name == "study":
        record = json.loads(again.idata.attrs["missing_effects"])
        assert record["verdict"] == "partly named" and record["effects"][0]["slug"] == "dead-zone"
