"""The progress bar of a benchmark whose work is a list."""

from collections.abc import Iterator, Sequence
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

Piece = TypeVar("Piece")


def shown(todo: Sequence[Piece], what: str, progress: bool) -> Iterator[Piece]:
    """The pieces one after the other, with a bar on stderr.

    Args:
        todo: What is to be done.
        what: What it is called.
        progress: Whether to show the bar.
    """
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), disable=not progress) as bar:
        yield from bar.track(todo)
