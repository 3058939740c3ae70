"""Progress of long work on one display: a line for each stage, with a bar where its length is known.

Whoever begins long work opens a display with `stages`; work inside joins it with `stage`, however deep. Without a
terminal, each stage that took long is a line of text once it is over, and now and then one while it lasts, so that a
log shows where the time went.
"""

import logging
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from datetime import timedelta

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
from rich.text import Text

WORTH_SAYING = 1.0
"""Seconds from which on a log states how long a stage took."""

SAID_FIRST, SAID_EVERY = 2.0, 30.0
"""Seconds after which a log states the progress of a stage, the first time and then again and again."""

log = logging.getLogger(__name__)

_DISPLAY: ContextVar["Display | None"] = ContextVar("display", default=None)


class Display:
    """Lines of stages on stderr: bars in a terminal and in a notebook, text for long stages elsewhere."""

    def __init__(self, console: Console, answers: bool = True) -> None:
        self.console, self.answers = console, answers
        self.live = console.is_terminal or console.is_jupyter
        self.open: list[Stage] = []
        self._over = threading.Event()
        self._clock = threading.Thread(target=self._report, daemon=True)
        self.bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            _Count(),
            TimeElapsedColumn(),
            _Left(),
            TextColumn("{task.fields[note]}"),
            console=console,
            disable=not self.live,
            # Printed text goes above the bars, unless stdout is a file.
            redirect_stdout=sys.stdout.isatty(),
        )

    def __enter__(self) -> "Display":
        self.bars.start()
        if not self.live:
            self._clock.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.bars.stop()
        self._over.set()
        if not self.live:
            self._clock.join()

    def _report(self) -> None:
        """Print the progress of the innermost stage, soon and then every now and then, until all is over."""
        pause = SAID_FIRST
        while not self._over.wait(pause):
            pause = SAID_EVERY
            for stage in self.open[-1:]:
                self.console.print(stage.so_far(), highlight=False, markup=False)


class Stage:
    """One line of a display; every thread may move it."""

    def __init__(self, display: Display | None, text: str, total: int | None) -> None:
        self._display, self._text, self._total = display, text, total
        self._begun = time.perf_counter()
        self._note, self._count = "", 0
        if display is not None:
            self._task = display.bars.add_task(text, total=total, note="")
            display.open.append(self)

    def advance(self, by: int = 1, note: str = "") -> None:
        """Move the bar by so many pieces, with a note beside it."""
        self._note, self._count = note, self._count + by
        if self._display is not None:
            self._display.bars.update(self._task, advance=by, note=note)

    def so_far(self) -> str:
        """Describe the progress of the stage, and its time so far."""
        count = f", {self._count}/{self._total}" if self._total is not None and self._total > 1 else ""
        note = f", {self._note}" if self._note else ""
        return f"{self._text}{count}{note}: {time.perf_counter() - self._begun:.0f} s so far"

    def done(self, said: bool = True) -> None:
        """Fill the bar, stop its clock and, where there are no bars, state how long it took."""
        seconds = time.perf_counter() - self._begun
        log.debug("%s: %.3f s", self._text, seconds)
        if self._display is None:
            return
        self._display.open.remove(self)
        if self._total is None:
            # Its length was unknown: it is complete now.
            self._display.bars.update(self._task, total=1, completed=1, note="")
        self._display.bars.stop_task(self._task)
        if said and not self._display.live and seconds >= WORTH_SAYING:
            self._display.console.print(f"{self._text}: {seconds:.0f} s", highlight=False, markup=False)


@contextmanager
def stages(show: bool, answers: bool = True) -> Iterator[None]:
    """Open a display of all stages of some work, or join the one around it; without `show` nothing within is shown.

    `answers` is false where results are printed behind the work anyway, and not before it is over.
    """
    if show and _DISPLAY.get() is not None:
        yield
        return
    with Display(Console(stderr=True), answers) if show else nullcontext() as display:
        token = _DISPLAY.set(display)
        try:
            yield
        finally:
            _DISPLAY.reset(token)


@contextmanager
def stage(text: str, total: int | None = None, said: bool = True) -> Iterator[Stage]:
    """Show one stage of some work, of `total` pieces, in the open display; a log states how long it took if `said`."""
    line = Stage(_DISPLAY.get(), text, total)
    try:
        yield line
    except BaseException:
        line.done(said=False)
        raise
    line.done(said)


def announce(text: str, answer: bool = False) -> None:
    """Print a remark above the lines of the open display; one that was opened without answers prints no `answer`."""
    display = _DISPLAY.get()
    if display is not None and (display.answers or not answer):
        display.console.print(text, highlight=False, markup=False)


class _Count(ProgressColumn):
    """Pieces done of all, where their number is known."""

    def render(self, task: Task) -> Text:
        known = task.total is not None and task.total > 1
        return Text(f"{task.completed:.0f}/{task.total:.0f}" if known else "")


class _Left(ProgressColumn):
    """Remaining time, where it can be estimated and is a second or more."""

    def render(self, task: Task) -> Text:
        left = None if task.finished else task.time_remaining
        return Text("" if left is None or left < 1 else f"{timedelta(seconds=round(left))} left", "dim")
