"""What a sample of a stream's runs says alone, and not all of them."""

from collections.abc import Iterator
from contextlib import contextmanager

from bayes_greybox.data.streams.row_stream import RowStream
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError


@contextmanager
def of_the_sample(sample: Trajectories, stream: RowStream) -> Iterator[None]:
    """Whatever is refused within is of the sample, and says so.

    Args:
        sample: Whole runs, as they were measured.
        stream: What they are some of.
    """
    try:
        yield
    except InputError as error:
        runs = "1 run" if sample.n_run == 1 else f"{sample.n_run} runs"
        raise InputError(
            f"In the sample of {runs} of {stream.source.where}: {error} If it is otherwise in other runs, look at "
            "more of them: bg.stream(..., sample=...)."
        ) from error
