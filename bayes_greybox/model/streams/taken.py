"""The data of a fit: rows in memory, or a stream of them with a sample that is looked at."""

from dataclasses import replace
from typing import NamedTuple

from bayes_greybox.data.streams.row_stream import RowStream
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError

from ..estimate.near import nearer
from ..noise.asked import Noise
from ..program import Program
from .passes import Whole, of_the_sample, whole_of
from .statistics import equations_of

MOST_PASSES = 5
"""Most times that rows of paths are taken anew near the estimate on all runs: each is a pass over them."""


class Taken(NamedTuple):
    """Model, with the kind of rows and the noise that the data have, and data of a fit; of a stream all rows too."""

    model: Program
    data: Trajectories
    whole: Whole | None = None


def taken(model: Program, data: Trajectories | RowStream) -> Taken:
    """Return model and training data as a fit takes them."""
    if not isinstance(data, RowStream):
        return Taken(*Program.with_noise_found(*Program.near(model, data)))
    sample = data.sample
    model = model.on(sample)
    _require_streamed(model)
    if not model.rows.linear:
        return _runs_taken(model, data.whole_runs())
    rows = [model.equation_rows(sample, block) for block in model.blocks]
    if any(each.operator is not None or not each.noise.local for each in rows):
        raise InputError("A stream is of rows that are measured one by one, and these know of their neighbours.")
    whole = whole_of(data, model, sample)
    return Taken(model, _remarked(sample, data, whole, "stretches"), whole)


def _runs_taken(model: Program, data: RowStream) -> Taken:
    """Take rows of paths, run by run, near the estimate on some whole runs at first, then near that on all."""
    measured, earlier = data.sample, None
    # Names are those of all runs.
    model.dictionaries(measured)
    model.simulator(measured)
    with of_the_sample(measured, data):
        model, sample = model.near(measured)
    for turn in range(MOST_PASSES):
        whole = whole_of(data, model, sample)
        lean = replace(model, discrepancy=None)
        (equation,) = equations_of(lean, sample, whole.statistics(lean)).values()
        moved = nearer(model, equation, earlier, turn == MOST_PASSES - 1)
        if moved is None:
            remarked, n_run = _remarked(sample, data, whole, "whole runs"), whole.extent.n_run
            if silent := n_run - whole.extent.n_telling:
                short = "are too short or too coarsely sampled for a test function"
                why = "have no row" if model.rows.follows_path else short
                remarked = remarked.remarked(f"{silent:,} of {n_run:,} runs {why} and say nothing")
            return Taken(model, remarked, whole)
        earlier, model = model, moved
        with of_the_sample(measured, data):
            sample = model.complete(measured)
    raise InputError(
        f"The coefficients of {', '.join(model.equations)} do not settle: rows were taken near what all runs say "
        f"{MOST_PASSES} times. Leave terms out, or look at more runs, bg.stream(..., sample=...), which the first are "
        "near."
    )


def _remarked(sample: Trajectories, data: RowStream, whole: Whole, pieces: str) -> Trajectories:
    remark = (
        f"{whole.extent.n_row:,} rows of {data.source.where} were read in chunks; of these, {sample.n_obs} rows in "
        f"{sample.n_run} {pieces}, evenly spaced over its parts, are looked at one by one"
    )
    dropped = whole.extent.dropped
    left_out = (f"{dropped:,} rows with missing values were left out",) if dropped else ()
    return sample.remarked(remark, *left_out)


def _require_streamed(model: Program) -> None:
    """Refuse what needs all rows at once."""
    if model.named.curved:
        raise InputError(
            "A stream takes no learned parameters that its formulas are not linear in, as tangents are taken anew at "
            "the estimate: give them as numbers, or fit so many rows as memory holds, read by bg.read."
        )
    if model.starts:
        raise InputError(
            f"The hidden state {next(iter(model.starts))!r} is followed through whole runs, and a stream gives its "
            "rows by themselves: fit so many rows as memory holds, read by bg.read."
        )
    gp = model.discrepancy
    if gp is not None and gp.path == "exact":
        raise InputError("OrthogonalGP(path='exact') is dense and takes no stream: use path='hsgp'.")
    if isinstance(model.noise, Noise) and not model.noise.white:
        raise InputError(
            "GreyBox(noise=Noise(...)) is found on the residuals of all rows at once: give a stream "
            "GreyBox(noise=...) with a number, or fit so many rows as memory holds, read by bg.read."
        )
