"""A study's file holds the study: what was read shows, says and integrates what the study does."""

import json
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from tiny_study import judged

import bayes_greybox as bg
from bayes_greybox.criticism.kept.file import load_checked
from bayes_greybox.discovery import study_file
from bayes_greybox.discovery.answer.amendment import Remainder
from bayes_greybox.inference.kept import netcdf
from bayes_greybox.inference.kept.model_record import describe
from bayes_greybox.inference.kept.packing import TEXT


@pytest.fixture(scope="module", params=["sampled", "not sampled"])
def saved(request, study, tmp_path_factory):
    """A study, and what was read of its file."""
    made = replace(study, config='[data]\npath = "run.csv"\n')
    made = made if request.param == "sampled" else replace(made, fit=None)
    path = tmp_path_factory.mktemp("saved") / "study.nc"
    made.save(path)
    return made, bg.load(path)


@pytest.fixture(scope="module")
def file(study, tmp_path_factory):
    """The file of a study that was sampled."""
    path = tmp_path_factory.mktemp("file") / "study.nc"
    study.save(path)
    return path


def same(one, other) -> None:
    """Values, arrays and tables are equal to the last bit, and of the same kinds."""
    if isinstance(one, pd.DataFrame):
        pd.testing.assert_frame_equal(one, other, check_exact=True)
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    elif isinstance(one, bg.Trajectories):
        assert one.metadata() == other.metadata()
        pd.testing.assert_frame_equal(one.to_frame(), other.to_frame(), check_exact=True)
        same(one.samples, other.samples)
    elif isinstance(one, dict):
        assert list(one) == list(other)
        for key in one:
            same(one[key], other[key])
    elif isinstance(one, tuple | list):
        assert type(one) is type(other)
        for mine, its in zip(one, other, strict=True):
            same(mine, its)
    elif is_dataclass(one):
        assert type(one) is type(other)
        for each in fields(one):
            same(getattr(one, each.name), getattr(other, each.name))
    else:
        assert one == other or (one != one and other != other)


MODELS = ("base", "model", "fit", "amendments")


def test_every_table_map_and_path_comes_back(saved):
    made, read = saved
    assert isinstance(read, bg.Study) and (read.fit is None) is (made.fit is None)
    for each in fields(made):
        if each.name not in MODELS:
            same(getattr(made, each.name), getattr(read, each.name))


def test_so_do_the_models_and_the_posterior(saved):
    made, read = saved
    for name, data in (("base", made.train), ("model", made.corrected)):
        assert isinstance(getattr(read, name), bg.GreyBox)
        assert describe(getattr(read, name), data) == describe(getattr(made, name), data)
    if made.fit is not None:
        assert list(read.fit.idata.children) == list(made.fit.idata.children)
        assert read.fit.idata.attrs == made.fit.idata.attrs
        xr.testing.assert_identical(read.fit.idata["posterior"].dataset, made.fit.idata["posterior"].dataset)
        assert read.fit.data is read.corrected


# With draws or without them it is asked once each: equations do not read the posterior, its page does.
@pytest.mark.parametrize("saved", ["not sampled"], indirect=True)
def test_equations_and_free_runs_are_those_of_the_study(saved):
    made, read = saved
    assert repr(read) == repr(made) and read.to_json() == made.to_json() and read.record() == made.record()
    x, u = np.random.default_rng(0).normal(size=(5, 2)), np.ones((5, 1))
    for settings in ({}, {"draws": 7}, {"draws": 7, "discrepancy": True}):
        np.testing.assert_array_equal(read.to_callable(**settings)(0.0, x, u), made.to_callable(**settings)(0.0, x, u))
    same(read.free_run(made.test), made.free_run(made.test))


@pytest.mark.parametrize("saved", ["sampled"], indirect=True)
def test_the_page_from_the_file_is_the_page_of_the_study(saved, tmp_path):
    # Figures of what comes back to the last bit, as is asked above, take most of the time of a page.
    made, read = (replace(each, maps={}, traces={}, paths={}) for each in saved)
    # What the verdict on a hundred draws is was made up for all tests of pages.
    read = replace(read, fit=judged(read.fit, True))
    made.to_html(tmp_path / "made.html")
    read.to_html(tmp_path / "read.html")
    assert (tmp_path / "read.html").read_bytes() == (tmp_path / "made.html").read_bytes()
    assert "path = &#34;run.csv&#34;" in (tmp_path / "read.html").read_text(encoding="utf-8")


def test_what_has_no_name_is_kept_with_the_f_that_stands_for_it(study, tmp_path):
    amendment = study.amendments["ydot"]
    known, rng = amendment.statistics, np.random.default_rng(2)
    n, of = known.basis.size, amendment.after.indices[-1:]
    f = Remainder(known, of, rng.normal(size=(1, n)), rng.normal(size=n), 0.1 * np.eye(n))
    made = replace(study, amendments={"ydot": replace(amendment, discrepancy=f)})
    made.save(tmp_path / "study.nc")
    read = bg.load(tmp_path / "study.nc")
    assert "f_ydot" in str(read.to_sympy()) and read.to_json() == made.to_json()
    same(read.free_run(made.test), made.free_run(made.test))


def test_the_posterior_alone_is_read_as_that_of_a_fit(study, file):
    alone = load_checked(file)
    assert list(alone.idata.children) == list(study.fit.idata.children)
    # For programs that read netCDF, and for the page of the fit.
    assert json.loads(alone.idata.attrs["missing_effects"])["verdict"] == "named"


@pytest.fixture
def in_layout(file, tmp_path):
    """Return the path of a copy of the file in another layout."""
    with xr.open_datatree(file, engine="h5netcdf") as opened:
        tree = opened.load()
    group = tree[netcdf.STUDIED].dataset
    record = json.loads(group.attrs[TEXT])

    def written(layout):
        text = json.dumps({**record, "format": layout})
        tree[netcdf.STUDIED] = xr.DataTree(group.assign_attrs({TEXT: text}))
        netcdf.write(tree, tmp_path / "other.nc")
        return tmp_path / "other.nc"

    return written


def test_a_later_layout_leaves_the_fit(in_layout):
    assert isinstance(bg.load(in_layout(study_file.STUDY_FORMAT + 1)), bg.Fit)


def test_an_earlier_layout_is_to_be_studied_again(in_layout):
    with pytest.raises(bg.InputError, match="a study in layout 1.*run the study again"):
        bg.load(in_layout(1))
