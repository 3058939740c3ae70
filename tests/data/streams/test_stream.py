"""Files are read in pieces, with the same names, units and refusals as at once."""

import numpy as np
import pytest
from streamed import NAMES, chunk, chunks, frame, written

import bayes_greybox as bg
from bayes_greybox.data.streams import door
from bayes_greybox.data.streams.row_stream import RowStream, Source
from bayes_greybox.running.errors import InputError


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch):
    """Chunks of 200 rows, parts of 700."""
    monkeypatch.setattr(door, "CHUNK_ROWS", 200)
    monkeypatch.setattr(door, "PART_ROWS", 700)


def _file(folder, kind, table):
    return written(folder, kind, table, {"y": "m", "t": "s"})


def _rows(stream):
    return [piece for part in range(stream.source.n_part) for piece in stream.source.chunks(part)]


@pytest.mark.parametrize("kind", ["parquet", "nc", "zarr"])
def test_pieces_are_the_rows_of_the_file_in_order(tmp_path, kind):
    table = frame()
    stream = bg.stream(_file(tmp_path, kind, table), **NAMES)
    assert isinstance(stream.source, Source) and stream.source.n_part > 1
    pieces = _rows(stream)
    assert max(piece.n_obs for piece in pieces) <= 200 and set(pieces[0].columns) == {"y", "ydot"}
    for name, column in (("y", "y"), ("ydot", "ydot")):
        np.testing.assert_array_equal(np.concatenate([piece.states[name] for piece in pieces]), table[column])
    np.testing.assert_array_equal(np.concatenate([piece.rate("ydot") for piece in pieces]), table["a"])
    np.testing.assert_array_equal(np.concatenate([piece.time for piece in pieces]), table["t"])
    assert stream.sample.units == ({} if kind == "parquet" else {"y": "m", "t": "s"})


def test_names_in_the_header_lose_their_units_and_several_files_follow_each_other(tmp_path):
    for i in range(2):
        frame(500, seed=i).rename(columns={"y": "y [mm]"}).to_parquet(tmp_path / f"part{i}.parquet")
    stream = bg.stream(tmp_path / "part*.parquet", **NAMES)
    assert sum(piece.n_obs for piece in _rows(stream)) == 1000 and stream.sample.unit("y") == "mm"
    assert "and 1 more" in repr(stream)


def test_files_of_one_stream_have_the_same_headers(tmp_path):
    table = frame(300)
    paths = [tmp_path / f"{i}.parquet" for i in range(2)]
    table.rename(columns={"y": "y [mm]"}).to_parquet(paths[0])
    table[:0].to_parquet(tmp_path / "empty.parquet")
    for other, words in (
        (table.rename(columns={"y": "y [m]"}), r'"y \[mm\]" of ".*0.parquet" is "y \[m\]" in ".*1.parquet".*same unit'),
        (table.drop(columns="y"), r'1.parquet" has no column "y.*other'),
        (table.assign(y=table["y"].astype(str)).rename(columns={"y": "y [mm]"}), '1.parquet" does not hold numbers'),
    ):
        other.to_parquet(paths[1])
        with pytest.raises(InputError, match=words):
            bg.stream([tmp_path / "empty.parquet", *paths], **NAMES)


def test_time_that_goes_back_is_refused_with_what_helps(tmp_path):
    path = tmp_path / "rows.parquet"
    table = frame(300)
    table.assign(t=np.tile(table["t"][:150], 2)).to_parquet(path)
    with pytest.raises(InputError, match='goes back in row 150.*restart="run"'):
        _rows(bg.stream(path, **NAMES))
    pieces = _rows(bg.stream(path, **NAMES, restart="run"))
    assert [piece.run_lengths for piece in pieces] == [(150, 50), (100,)]


def test_the_sample_is_ten_stretches_of_neighbours_and_no_row_twice(tmp_path):
    table = frame()
    stream = bg.stream(_file(tmp_path, "parquet", table), **NAMES, sample=400)
    data = stream.sample
    row = np.rint(data.time / 1e-3).astype(int)
    assert len(set(row)) == len(row) and 300 <= len(row) <= 400
    # Evenly over the parts, of which the last is shorter.
    assert set(np.searchsorted([900, 1800, 2700], row, side="right")) == {0, 1, 2, 3}
    assert max(np.diff(np.sort(row))) < len(table) / 5
    for start, stop in zip(np.cumsum([0, *data.run_lengths[:-1]]), np.cumsum(data.run_lengths), strict=True):
        assert np.all(np.diff(row[start:stop]) == 1)
    np.testing.assert_array_equal(data.states["y"], table["y"].to_numpy()[row])


def test_few_rows_are_all_looked_at_once():
    few = RowStream.from_chunks(lambda i: bg.read(frame(30, seed=i), **NAMES), 2)
    assert few.sample.n_obs == 60


def test_rows_are_numbered_without_stamps(tmp_path):
    stream = bg.stream(_file(tmp_path, "parquet", frame()), **{**NAMES, "time": None})
    np.testing.assert_array_equal(np.concatenate([piece.time for piece in _rows(stream)]), np.arange(3000))


def test_missing_values_are_refused_with_their_place_or_left_out_and_counted(tmp_path):
    table = frame()
    table.loc[1234, "y"] = np.nan
    table.loc[1400:1999, "a"] = np.nan  # whole chunks
    for kind in ("parquet", "nc"):
        path = _file(tmp_path, kind, table)
        with pytest.raises(InputError, match=r"from its row 1[01]\d\d: .*\"y\" has 1 missing"):
            _rows(bg.stream(path, **NAMES))
        kept = _rows(bg.stream(path, **NAMES, missing="drop"))
        assert sum(piece.n_obs for piece in kept) == 3000 - 601
        np.testing.assert_array_equal(
            np.concatenate([piece.time for piece in kept]), table.dropna(subset=["y", "a"])["t"]
        )


def test_what_cannot_be_read_in_pieces_is_refused(tmp_path):
    table = frame(100)
    path = _file(tmp_path, "parquet", table)
    with pytest.raises(InputError, match='has no column "z"'):
        bg.stream(path, states=["z"])
    with pytest.raises(InputError, match='"when" .* does not hold numbers.*seconds'):
        other = tmp_path / "dates.parquet"
        table.assign(when="2024-01-01").to_parquet(other)
        bg.stream(other, **{**NAMES, "time": "when"})
    with pytest.raises(InputError, match="different dimensions"):
        bg.stream(_file(tmp_path, "nc", table), **NAMES, inputs=["elsewhere"])
    with pytest.raises(InputError, match="all of one kind"):
        bg.stream([path, tmp_path / "rows.nc"], **NAMES)
    with pytest.raises(InputError, match="read smaller ones by bg.read"):
        bg.stream(tmp_path / "rows.csv", **NAMES)
    with pytest.raises(InputError, match="There is no file"):
        bg.stream(tmp_path / "none.parquet", **NAMES)
    with pytest.raises(InputError, match="from_chunks"):
        bg.stream(table, **NAMES)
    (tmp_path / "broken.parquet").write_bytes(b"PAR1 no")
    with pytest.raises(InputError, match="cannot be read as parquet"):
        bg.stream(tmp_path / "broken.parquet", **NAMES)


def test_chunks_of_a_function_are_measured_rows_of_one_kind():
    with pytest.raises(InputError, match="not a DataFrame"):
        _ = RowStream.from_chunks(lambda i: frame(10), 1).sample
    with pytest.raises(InputError, match="none beside a chunk"):
        decay = bg.systems.oscillator().simulate(np.linspace(0, 5, 200), seed=0)
        filtered = bg.Trajectories.from_arrays(decay.time, states=dict(decay.states)).differentiate()
        _ = RowStream.from_chunks(lambda i: filtered, 1).sample
    with pytest.raises(InputError, match="same states"):
        _ = RowStream.from_chunks(lambda i: chunk(i) if i else bg.read(frame(), states=["y"], time="t"), 2).sample
    with pytest.raises(InputError, match="not both"):
        chunks(workers=2, scheduler="tcp://127.0.0.1:1")
