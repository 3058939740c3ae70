"""Whole runs of files, however their rows lie in pieces, are those that `bg.read` gives of all rows at once."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from streamed import written

import bayes_greybox as bg
from bayes_greybox.data.streams import door, whole_runs
from bayes_greybox.data.streams.row_stream import RowStream, Source
from bayes_greybox.running.errors import InputError

NAMES = {"states": ["x"], "inputs": ["u"], "time": "t"}
LENGTHS = (90, 333, 120, 50, 260, 75, 30, 99)


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch):
    """Pieces of 100 rows, runs of 150 rows together."""
    monkeypatch.setattr(door, "CHUNK_ROWS", 100)
    monkeypatch.setattr(door, "PART_ROWS", 400)
    monkeypatch.setattr(whole_runs, "ROWS_HELD_TOGETHER", 150)


def table(lengths=LENGTHS):
    rng = np.random.default_rng(0)
    parts = [
        pd.DataFrame({"t": 0.1 * np.arange(n), "x": rng.standard_normal(n), "u": rng.standard_normal(n), "id": 10 * r})
        for r, n in enumerate(lengths)
    ]
    return pd.concat(parts, ignore_index=True)


def file_of(folder, kind, rows, name="runs"):
    return written(folder, kind, rows, {"x": "m"}, 100, name)


def runs_of(stream):
    stream = stream.whole_runs()
    return [chunk for part in range(stream.source.n_part) for chunk in stream.source.chunks(part)]


def same(chunks, data):
    """Whether chunks are data, run by run."""
    assert [name for chunk in chunks for name in chunk.run_names] == list(data.run_names)
    assert [n for chunk in chunks for n in chunk.run_lengths] == list(data.run_lengths)
    for pick in (lambda d: d.time, lambda d: d.states["x"], lambda d: d.inputs["u"]):
        np.testing.assert_array_equal(np.concatenate([pick(chunk) for chunk in chunks]), pick(data))
    return True


@pytest.mark.parametrize("kind", ["parquet", "nc", "zarr"])
def test_runs_cut_by_pieces_are_put_together(tmp_path, kind):
    rows = table()
    stream = bg.stream(file_of(tmp_path, kind, rows), **NAMES, run="id")
    chunks = runs_of(stream)
    assert isinstance(stream.whole_runs().source, Source)
    # The longest lies in four pieces; none is held with more than 150 rows of others before it.
    assert len(chunks) > 3 and max(chunk.n_obs for chunk in chunks) <= 150 + max(LENGTHS)
    assert same(chunks, bg.read(rows, **NAMES, run="id"))
    assert chunks[0].units == ({} if kind == "parquet" else {"x": "m"})


def test_files_are_read_in_any_order_with_runs_named_as_in_memory(tmp_path):
    paths = [
        file_of(tmp_path, "parquet", table(lengths), name) for name, lengths in (("a", (90, 200)), ("b", (60, 250)))
    ]
    for order in (paths, paths[::-1]):
        assert same(runs_of(bg.stream(order, **NAMES, run="id")), bg.read(order, **NAMES, run="id"))
    # Without a column of runs a file is one.
    alone = [file_of(tmp_path, "parquet", table((n,)), f"run{n}") for n in (333, 70)]
    assert same(runs_of(bg.stream(alone, **NAMES)), bg.read(alone, **NAMES))


def test_one_run_and_time_that_goes_back(tmp_path):
    one = table((500,))
    assert same(runs_of(bg.stream(file_of(tmp_path, "parquet", one), **NAMES)), bg.read(one, **NAMES))
    rows = table().drop(columns="id")
    path = file_of(tmp_path, "parquet", rows)
    chunks = runs_of(bg.stream(path, **NAMES, restart="run"))
    assert len(chunks) > 3 and same(chunks, bg.read(rows, **NAMES, restart="run"))
    with pytest.raises(InputError, match='goes back in row 90.*restart="run"'):
        runs_of(bg.stream(path, **NAMES))


def test_a_gap_within_a_run_parts_it_as_in_memory(tmp_path):
    rows = table((300, 60))
    rows.loc[150:299, "t"] += 1000.0
    data = bg.read(rows, **NAMES, run="id")
    assert data.n_run == 3
    assert same(runs_of(bg.stream(file_of(tmp_path, "parquet", rows), **NAMES, run="id")), data)


def test_missing_values_of_a_run_are_refused_or_left_out(tmp_path):
    rows = table()
    rows.loc[200:210, "x"] = np.nan
    path = file_of(tmp_path, "parquet", rows)
    with pytest.raises(InputError, match='"x" has 11 missing.*row 110 of run "10"'):
        runs_of(bg.stream(path, **NAMES, run="id"))
    chunks = runs_of(bg.stream(path, **NAMES, run="id", missing="drop"))
    assert sum(chunk.dropped for chunk in chunks) == 11
    assert same(chunks, bg.read(rows, **NAMES, run="id", missing="drop"))


@pytest.mark.parametrize("kind", ["parquet", "nc"])
@pytest.mark.parametrize("run", [None, "id"])
def test_a_run_ends_where_its_rows_are_missing_as_in_memory(tmp_path, kind, run):
    rows = table((60, 60, 130, 60)).assign(id=7)
    # The time goes back between rows that are left out, once between two pieces, and once without stamps.
    rows.loc[30:89, "x"] = np.nan
    rows.loc[95:104, "t"] = np.nan
    rows.loc[200:260, "u"] = np.nan
    data = bg.read(rows, **NAMES, run=run, restart="run", missing="drop")
    assert data.n_run == 4
    stream = bg.stream(file_of(tmp_path, kind, rows), **NAMES, run=run, restart="run", missing="drop")
    assert same(runs_of(stream), data)


def test_a_run_without_any_values_is_left_out_and_parts_its_neighbours(tmp_path):
    rows = table((60, 60, 60)).drop(columns="id")
    # From the end of the first to the beginning of the third the time goes on.
    rows["t"] += np.repeat([0.0, 5.0, 8.0], 60)
    rows.loc[60:119, "x"] = np.nan
    chunks = runs_of(bg.stream(file_of(tmp_path, "parquet", rows), **NAMES, restart="run", missing="drop"))
    assert [chunk.run_lengths for chunk in chunks] == [(60,), (60,)] and chunks[1].dropped == 60


def test_rows_that_name_no_run_are_refused(tmp_path):
    rows = table((60, 60)).assign(id=lambda frame: frame["id"].astype(float))
    rows.loc[70, "id"] = np.nan
    with pytest.raises(InputError, match='"id" of .* names no run in row 70;'):
        runs_of(bg.stream(file_of(tmp_path, "parquet", rows), **NAMES, run="id", missing="drop"))


@pytest.mark.parametrize("rows_held", [10, 100_000])
def test_runs_that_lie_apart_are_refused_however_many_there_are(tmp_path, monkeypatch, rows_held):
    monkeypatch.setattr(whole_runs, "ROWS_HELD_TOGETHER", rows_held)
    monkeypatch.setattr(whole_runs, "REMEMBERED_RUNS", 3)
    rows = table((12,) * 10)
    rows.loc[rows["id"] == 90, "id"] = 70
    with pytest.raises(InputError, match="run 70 of .* lie apart"):
        runs_of(bg.stream(file_of(tmp_path, "parquet", rows), **NAMES, run="id"))


def test_what_is_no_run_in_one_piece_is_refused(tmp_path):
    rows = table()
    apart = pd.concat([rows, rows[rows["id"] == 0].assign(t=lambda r: r["t"] + 100)], ignore_index=True)
    with pytest.raises(InputError, match='run 0 of ".*" lie apart.*sort the rows of the file by "id"'):
        runs_of(bg.stream(file_of(tmp_path, "parquet", apart), **NAMES, run="id"))
    path = file_of(tmp_path, "parquet", rows)
    with pytest.raises(InputError, match="have no stamps: name their column, time="):
        bg.stream(path, states=["x"], run="id").whole_runs()


def test_the_sample_is_of_whole_runs_and_all_of_them_where_there_are_no_more(tmp_path):
    rows = table()
    stream = bg.stream(file_of(tmp_path, "parquet", rows), **NAMES, run="id", sample=len(rows)).whole_runs()
    assert same([stream.sample], bg.read(rows, **NAMES, run="id"))
    some = bg.stream(tmp_path / "runs.parquet", **NAMES, run="id", sample=400).whole_runs().sample
    lengths = dict(zip((str(10 * r) for r in range(8)), LENGTHS, strict=True))
    assert 1 < some.n_run < 8 and 400 <= some.n_obs < 400 + max(LENGTHS)
    assert all(lengths[name] == n for name, n in zip(some.run_names, some.run_lengths, strict=True))


def chunk(i):
    return bg.read(table((40 + i % 3, 30)).drop(columns="id"), **NAMES, restart="run")


def test_many_small_parts_are_sampled_evenly_and_runs_of_one_name_told_apart():
    stream = RowStream.from_chunks(chunk, 40, sample=700).whole_runs()
    assert 700 <= stream.sample.n_obs < 900 and len(set(stream.sample.run_names)) == stream.sample.n_run
    parts = sorted({int(name.rsplit(" ", 1)[1]) for name in stream.sample.run_names})
    assert parts[0] <= 4 and parts[-1] >= 35 and max(np.diff(parts)) <= 8
    every = RowStream.from_chunks(chunk, 40, sample=10_000).whole_runs().sample
    assert every.n_run == 80


def test_the_rest_of_a_sample_comes_from_files_that_have_more(tmp_path):
    paths = [file_of(tmp_path, "parquet", table((n // 10,) * 10), str(n)) for n in (1500, 500)]
    for size, n in ((2000, 2000), (1700, 1800), (600, 600)):
        stream = bg.stream(paths, **NAMES, run="id", sample=size).whole_runs()
        assert size <= stream.sample.n_obs <= n


def test_samples_that_no_sensor_saw_stay_those_of_their_runs():
    data = bg.read(table((40, 30, 50)), **NAMES, run="id")
    marked = np.arange(30) % 7 == 0
    runs = [replace(data.take(i), unseen=marked if i == 1 else None) for i in range(3)]
    sample = RowStream.from_chunks(lambda i: runs[i], 3).whole_runs().sample
    np.testing.assert_array_equal(sample.unseen, np.concatenate([np.zeros(40, bool), marked, np.zeros(50, bool)]))
    assert sample.take(2).unseen.shape == (50,)
    completed = replace(runs[0], samples=runs[0])
    with pytest.raises(InputError, match="completed.*give chunks as they were measured, data.samples"):
        RowStream.from_chunks(lambda i: completed, 1).whole_runs().sample  # noqa: B018
