"""The progress bar of a benchmark whose work is a list."""

from collections.abc import Iterator, Sequence
from typing import TypeVar

from bayes_greybox.running.stages import stage, stages

Piece = TypeVar("Piece")


def shown(todo: Sequence[Piece], what: str, progress: bool) -> Iterator[Piece]:
    """The pieces one after the other, with a bar on stderr.

    Args:
        todo: What is to be done.
        what: What it is called.
        progress: Whether to show the bar.
    """
    with stages(progress), stage(what, len(todo)) as line:
        for piece in todo:
            yield piece
            line.advance()
