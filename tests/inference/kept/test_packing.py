"""Values go through text and arrays unchanged; what a file cannot hold is refused."""

import json
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import bayes_greybox as bg
from bayes_greybox.inference.kept.packing import Packer, Unpacker, as_group, group_arrays
from bayes_greybox.physics.hidden_states import HiddenState


@dataclass(frozen=True)
class Pair:
    first: object
    second: object = 3


class Named(NamedTuple):
    values: object


def through(value, **options):
    packer = Packer((Pair, Named), **options)
    text = json.dumps(packer.pack(value, "d(y)/dt"))
    assert all(name.isidentifier() and array.dtype != bool for name, array in packer.arrays.items())
    return Unpacker((Pair, Named), packer.arrays).unpack(json.loads(text))


@pytest.mark.parametrize(
    "value",
    [
        None, True, 3, 0.1, float("inf"), "ẋ", (1, (2.5, "a")), [(), []], {"a": (1,), "b": None}, {("e", "s"): 1},
        Pair(Named((1, 2)), {"x": (Pair(1),)}),
    ],
)  # fmt: skip
def test_values_keep_their_kinds(value):
    found = through(value)
    assert found == value and type(found) is type(value)


@pytest.mark.parametrize("shape", [(), (3,), (0, 4), (40,), (5, 6)])
@pytest.mark.parametrize("dtype", [float, int, bool])
def test_arrays_small_and_large(shape, dtype):
    array = np.random.default_rng(0).integers(0, 2, shape).astype(dtype)
    found = through({"a": array, "b": (array,)})
    for each in (found["a"], found["b"][0]):
        assert each.dtype == array.dtype and each.shape == array.shape
        np.testing.assert_array_equal(each, array)


TABLE = pd.DataFrame({"equation": ["y", "v"], "p": [0.1, np.nan], "ok": [True, False], "tied": [("a", "b"), ()]})


@pytest.mark.parametrize(
    "table",
    [TABLE, TABLE.iloc[:0], TABLE.set_index("equation"), TABLE.set_index(["equation", "p"]), TABLE[["p"]].iloc[:0]],
    ids=["plain", "empty", "indexed", "twice", "column"],
)
def test_tables_keep_columns_kinds_and_index(table):
    pd.testing.assert_frame_equal(through(table), table, check_exact=True)


def test_data_are_held_once_and_are_the_same_object_again():
    data = bg.systems.oscillator().simulate(np.linspace(0.0, 5.0, 30), noise=0.02, seed=1)
    packer = Packer(())
    packed = packer.pack({"train": data, "clock": data}, "x")
    found = Unpacker((), packer.arrays).unpack(json.loads(json.dumps(packed)))
    assert found["clock"] is found["train"] and found["train"].metadata() == data.metadata()
    pd.testing.assert_frame_equal(found["train"].to_frame(), data.to_frame(), check_exact=True)


def test_terms_read_back_as_the_same_formulas():
    term = bg.Term("0.1*sin(y)*z", name="lag", unit="N", states=(HiddenState("z", "y - z", "y"),))
    packer = Packer((HiddenState,))
    found = Unpacker((HiddenState,), packer.arrays).unpack(packer.pack(term, "t"))
    assert (found.expr, found.name, found.unit, found.states) == (term.expr, term.name, term.unit, term.states)


def test_a_field_that_is_left_out_has_its_default_again():
    assert through(Pair(1, second=print), leave_out=("second",)) == Pair(1)


def test_a_class_that_is_not_listed_is_refused():
    with pytest.raises(TypeError, match="object at x is no kind of value"):
        Packer((Pair,)).pack(object(), "x")


def test_columns_may_be_called_as_dimensions_are(tmp_path):
    """A file's dimensions share its names with variables: columns x and x_0 were lost."""
    data = bg.Trajectories.from_arrays(
        np.arange(20) * 0.1,
        states={name: np.sin(np.arange(20) + k) for k, name in enumerate(("x", "x_0", "x_1"))},
        derivatives={"x": np.cos(np.arange(20))},
    )
    packer = Packer(())
    text = json.dumps(packer.pack({"data": data, "square": np.eye(20)}, "train"))
    as_group(text, packer.arrays).to_netcdf(tmp_path / "group.nc", engine="h5netcdf")
    stored, arrays = group_arrays(xr.load_dataset(tmp_path / "group.nc", engine="h5netcdf"))
    found = Unpacker((), arrays).unpack(json.loads(stored))
    assert found["data"].to_frame().equals(data.to_frame()) and np.array_equal(found["square"], np.eye(20))


def test_what_a_term_states_is_kept():
    term = bg.Term("y**3", sign="-", prior=(-40, 10), bounds=(-60, None))
    assert through(term) == term and through(term).stated == term.stated


def test_data_know_the_rows_before_them_and_what_was_computed():
    t = np.arange(30.0)
    data = bg.Trajectories.from_arrays(t, states={"q": t}, inputs={"u": t % 7}, outputs={"V": t})
    _, second = replace(data, computed=("q",)).split(0.5)
    found = through(second.split(0.5)[1])
    assert found.computed == ("q",) and found.before.before.before is None
    np.testing.assert_array_equal(found.before.before.states["q"], t[:15])
