"""Statistics of rows of paths, run by run, are those of all runs at once."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from streamed_runs import BOTH, animals, clipped, oscillations, path_of, stream_of, weak

import bayes_greybox as bg
from bayes_greybox.data.streams.row_stream import RowStream
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.estimate.near import nearer
from bayes_greybox.model.streams import taken as taking
from bayes_greybox.model.streams.statistics import equations_of
from bayes_greybox.model.streams.taken import taken
from bayes_greybox.running.errors import InputError

# What issue 16 asks for.
CLOSE = 1e-12
F = bg.OrthogonalGP(variables=("y",), features=6)
CASES = {
    "weak": (weak, {}, animals),
    "weak, f, one learned": (
        weak,
        {"dictionary": {"x": BOTH["x"]}, "simulation": {"y": "x*y - 4*y"}, "discrepancy": F},
        animals,
    ),
    "path": (lambda **own: bg.GreyBox(BOTH, discrepancy=None, **own), {}, lambda: animals(2)),
    "path, f, one seen": (path_of, {"discrepancy": F}, oscillations),
    "path, clipped sensor": (path_of, {}, clipped),
    "path, in segments": (path_of, {"rows": bg.TrajectoryRows(segment=6.0)}, oscillations),
    "path, unknown force": (path_of, {"rows": bg.TrajectoryRows(force=1e-3)}, oscillations),
    "path, unweighted measure": (path_of, {"discrepancy": replace(F, measure="unweighted")}, oscillations),
}


def statistics(model, stream):
    fitted, sample, whole = taken(model, stream)
    (equation,) = equations_of(fitted, sample, whole.statistics(fitted)).values()
    return fitted, equation


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=pytest.mark.slow) if case == "path" else case for case in CASES]
)
def test_they_are_those_of_all_runs_in_memory(case):
    make, settings, runs = CASES[case]
    given = replace(weak(), **settings) if make is weak else make(**settings)
    fitted, streamed = statistics(given, stream_of(runs()))
    expected_model, _ = given.near(runs())
    (memory,) = expected_model.assemble(runs()).values()
    assert fitted.rows == expected_model.rows
    sums = []
    for each in (streamed, memory):
        columns = [np.asarray(part) for part in (each.design.Phi, each.design.Psi, each.design.y)]
        table = np.column_stack(columns)
        sums.append(table.T @ table)
    size = np.sqrt(np.diag(sums[1]))
    off = float(np.max(np.abs(sums[0] - sums[1]) / np.outer(size, size)))
    determinant = abs(float(streamed.design.log_det_R) / float(memory.design.log_det_R) - 1)
    print(f"\n{case}: sums within {off:.1e} of the columns' sizes, log determinant within {determinant:.1e}")
    assert off <= CLOSE and determinant <= CLOSE
    for name in ("term_scale", "target_scale", "centre", "half_width"):
        np.testing.assert_allclose(getattr(streamed.frame, name), getattr(memory.frame, name), rtol=CLOSE)
    assert float(streamed.design.n_obs) == float(memory.design.n_obs)
    assert float(streamed.design.noise_floor) == float(memory.design.noise_floor)


def test_several_runs_of_a_chunk_and_other_orders_add_up_to_the_same():
    data = animals()
    order = [3, 0, 4, 2, 1]
    shuffled = Trajectories.from_arrays(
        [data.take(i).time for i in order],
        states={name: [data.take(i).states[name] for i in order] for name in ("x", "y")},
    )
    one = statistics(weak(), stream_of(data))[1]
    two = statistics(weak(), RowStream.from_chunks(lambda i: shuffled, 1, sample=10**6))[1]
    assert float(one.design.n_obs) == float(two.design.n_obs)
    sums = [np.asarray(each.design.Phi.T @ each.design.Phi) for each in (one, two)]
    # What runs have in common is found in their order, whose sums are rounded otherwise.
    np.testing.assert_allclose(sums[1], sums[0], atol=1e-6 * np.max(sums[0]))


def test_runs_that_are_too_short_for_a_test_function_say_nothing():
    data = animals()
    short = data.take(0).keep(slice(0, 14))
    pieces = [data.take(i) for i in range(data.n_run)] + [short]
    whole = Trajectories.from_arrays(
        [piece.time for piece in pieces],
        states={name: [piece.states[name] for piece in pieces] for name in ("x", "y")},
    )
    fitted, sample, rows = taken(weak(), stream_of(whole))
    assert "1 of 6 runs are too short or too coarsely sampled for a test function" in repr(sample)
    (streamed,) = equations_of(fitted, sample, rows.statistics(fitted)).values()
    (memory,) = fitted.assemble(whole).values()
    assert float(streamed.design.n_obs) == float(memory.design.n_obs) == len(memory.rows.measured)


def test_coefficients_that_some_runs_say_are_taken_anew_near_what_all_do(monkeypatch):
    data, turns = animals(24), []

    def counted(*arguments):
        turns.append(nearer(*arguments))
        return turns[-1]

    monkeypatch.setattr(taking, "nearer", counted)
    fitted, streamed = statistics(weak(), stream_of(data, sample=200))
    assert len(turns) > 1 and turns[-1] is None
    near = dict(zip(zip(fitted.rows.added_to, (t for t, _ in fitted.rows.added), strict=True),
                    (value for _, value in fitted.rows.added), strict=True))  # fmt: skip
    estimate = streamed.ridge()
    assert streamed.moved([(term, near[name, term.text]) for (term, _), name in
                           zip(estimate, streamed.frame.dictionary.acts_on, strict=True)]) < 0.5  # fmt: skip
    # All runs decide: the true coefficients are within five of their standard deviations, of which a fit of the
    # sample alone has more than twice as large ones.
    truth = [(term, value) for (term, _), value in zip(estimate, (2.0, -1.0, 1.0, -4.0), strict=True)]
    assert streamed.moved(truth) < 5.0
    assert float(streamed.design.n_obs) > 4 * len(streamed.rows.measured)


def test_a_term_that_all_rows_are_certain_of_comes_into_the_frozen_model():
    data = animals(2)
    near, _ = weak().near(data)
    added, to = near.rows.added, near.rows.added_to
    assert len(added) == 4
    # The other coefficients are those that the rows say without it.
    for _ in range(4):
        lacking = replace(near, rows=replace(near.rows, added=added[:-1], added_to=to[:-1]))
        (equation,) = lacking.assemble(data).values()
        found = nearer(lacking, equation)
        assert found is not None and found.rows.added_to == to
        added = found.rows.added
    # Neither does it stay away because another set led to this one: that has to be the one that was found.
    fewer = replace(near, rows=replace(near.rows, added=added[:-2], added_to=to[:-2]))
    assert nearer(lacking, equation, fewer) is not None and nearer(lacking, equation, fewer, last=True) is not None
    assert nearer(lacking, equation, found) is None


def test_what_the_sample_alone_says_is_told_so():
    data = animals(3)
    runs = [replace(data.take(i), inputs={"u": np.full(data.take(i).n_obs, float(i))}) for i in range(3)]
    model = replace(weak(), dictionary={"x": ["x", "x*y", "u"], "y": BOTH["y"]})
    some = RowStream.from_chunks(lambda i: runs[i], 3, sample=100)
    assert some.whole_runs().sample.n_run == 1
    with pytest.raises(InputError, match=r"In the sample of 1 run of chunks.*'x: u' .* zero.*bg\.stream\(..., sample="):
        taken(model, some)
    # That there is no such column is not said of the sample.
    with pytest.raises(InputError, match="^(?!In the sample).*'w'"):
        taken(replace(model, dictionary={"x": ["w"]}), some)
    with pytest.raises(InputError, match="^(?!In the sample).*'w'"):
        taken(replace(model, dictionary={"x": BOTH["x"]}, simulation={"y": "w"}), some)


def test_a_run_that_weak_rows_cannot_be_made_of_is_named():
    data = animals(3)
    runs = [
        replace(data.take(i), states={n: v - 9.0 * (i == 2) for n, v in data.take(i).states.items()}) for i in (0, 2)
    ]
    model = replace(weak(), dictionary={"x": BOTH["x"]}, simulation={"y": "x*y - 4*y + 0.01*sqrt(x + 2)"})
    with pytest.raises(InputError, match='In run "2" of chunks of a function: The rates of x, y are not finite'):
        taken(model, RowStream.from_chunks(lambda i: runs[i], 2, sample=100))


@pytest.mark.slow
@pytest.mark.parametrize("make, runs", [(weak, animals), pytest.param(path_of, oscillations, marks=pytest.mark.slow)])
def test_workers_give_the_same_to_the_last_bit(tmp_path, make, runs):
    distributed = pytest.importorskip("distributed")
    data = runs()
    for i in range(data.n_run):
        data.take(i).to_frame().to_parquet(tmp_path / f"{i}.parquet")
    names = {"states": list(data.state_names), "inputs": list(data.input_names), "time": "t", "sample": 200}
    fitted, _, here = taken(make(), bg.stream(tmp_path / "*.parquet", **names))
    mine = {name: one.digest for name, one in here.statistics(fitted).items()}
    # Workers of a scheduler stay for all passes; those of a stream's own begin anew with each.
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster:
        _, _, there = taken(make(), bg.stream(tmp_path / "*.parquet", **names, scheduler=cluster.scheduler_address))
        theirs = {name: one.digest for name, one in there.statistics(fitted).items()}
    assert mine == theirs


@pytest.mark.slow
def test_memory_is_that_of_the_sample_and_of_a_few_runs():
    data = animals()

    def of(n_run):
        return statistics(weak(), RowStream.from_chunks(lambda i: data.take(i % 5), n_run, sample=200))

    def peak(n_run):
        tracemalloc.start()
        of(n_run)
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    of(5)  # what is imported and kept at first use
    few = peak(4)
    # Five times the runs.
    assert peak(20) < 1.3 * few
