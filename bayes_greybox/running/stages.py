"""What long work is doing, on one display: a line for each stage, with a bar where its length is known.

Whoever begins long work opens a display with `stages`; what works inside joins it with `stage`, however deep. Without a
terminal each stage that took long is a line of text once it is over, so that a log says where the time went, and now
and then one while it lasts.
"""

import logging
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import timedelta

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
from rich.text import Text

WORTH_SAYING = 1.0
"""Seconds from which on a log says how long a stage took."""

SAID_FIRST, SAID_EVERY = 2.0, 30.0
"""Seconds after which a log is told what a stage is at, the first time and then again and again."""

log = logging.getLogger(__name__)

_DISPLAY: ContextVar["Display | None"] = ContextVar("display", default=None)


class Display:
    """Lines of stages on stderr: bars in a terminal and in a notebook, what took long in words elsewhere."""

    def __init__(self, console: Console, answers: bool = True) -> None:
        """Show nothing yet."""
        self.console, self.answers = console, answers
        self.live = console.is_terminal or console.is_jupyter
        self.open: list[Stage] = []
        self._over = threading.Event()
        self._clock = threading.Thread(target=self._tell, daemon=True)
        self.bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            _Count(),
            TimeElapsedColumn(),
            _Left(),
            TextColumn("{task.fields[note]}"),
            console=console,
            disable=not self.live,
            # What is printed beside goes above the bars, but never from a file into them.
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

    def _tell(self) -> None:
        """Say what the innermost stage is at, soon and then every now and then, until all is over."""
        pause = SAID_FIRST
        while not self._over.wait(pause):
            pause = SAID_EVERY
            for stage in self.open[-1:]:
                self.console.print(stage.so_far(), highlight=False, markup=False)


class Stage:
    """One line of a display; every thread may move it."""

    def __init__(self, display: Display | None, text: str, total: int | None) -> None:
        """Show it, unless there is no display."""
        self._display, self._text, self._total = display, text, total
        self._begun = time.perf_counter()
        self._task = None if display is None else display.bars.add_task(text, total=total, note="")
        self._note, self._count = "", 0
        if display is not None:
            display.open.append(self)

    def advance(self, by: int = 1, note: str = "") -> None:
        """Move the bar.

        Args:
            by: How far.
            note: What to say beside it.
        """
        self._note, self._count = note, self._count + by
        if self._display is not None and self._task is not None:
            self._display.bars.update(self._task, advance=by, note=note)

    def say(self, note: str) -> None:
        """What the stage is at."""
        self.advance(0, note)

    def so_far(self) -> str:
        """What it is at, how far, and since when."""
        count = f", {self._count}/{self._total}" if self._total is not None and self._total > 1 else ""
        note = f", {self._note}" if self._note else ""
        return f"{self._text}{count}{note}: {time.perf_counter() - self._begun:.0f} s so far"

    def done(self, said: bool = True) -> None:
        """Fill the bar and stop its clock, and say how long it took where there are no bars."""
        seconds = time.perf_counter() - self._begun
        log.debug("%s: %.3f s", self._text, seconds)
        if self._display is None or self._task is None:
            return
        if self in self._display.open:
            self._display.open.remove(self)
        if self._total is None:
            # Nobody knew how long it is: now it is as long as it got.
            self._display.bars.update(self._task, total=1, completed=1, note="")
        self._display.bars.stop_task(self._task)
        if said and not self._display.live and seconds >= WORTH_SAYING:
            self._display.console.print(f"{self._text}: {seconds:.0f} s", highlight=False, markup=False)


@contextmanager
def stages(show: bool, answers: bool = True) -> Iterator[None]:
    """A display of all stages of some work, or the one that is open around it.

    Args:
        show: Whether to show anything; without it stages within belong to no display.
        answers: Whether results are told before the work is over; not where they are printed behind it anyway.
    """
    if show and _DISPLAY.get() is not None:
        yield
        return
    if not show:
        token = _DISPLAY.set(None)
        try:
            yield
        finally:
            _DISPLAY.reset(token)
        return
    with Display(Console(stderr=True), answers) as display:
        token = _DISPLAY.set(display)
        try:
            yield
        finally:
            _DISPLAY.reset(token)


@contextmanager
def stage(text: str, total: int | None = None, said: bool = True) -> Iterator[Stage]:
    """One stage of some work; silent where no display is open.

    Args:
        text: What is done, such as "Sampling".
        total: Of how many pieces, where that is known.
        said: Whether a log is told how long it took.
    """
    display = _DISPLAY.get()
    line = Stage(display, text, total)
    try:
        yield line
    except BaseException:
        line.done(said=False)
        raise
    line.done(said)


def announce(text: str, answer: bool = False) -> None:
    """What is known before the work is over, above the lines of the display; silent where none is open.

    Args:
        text: What to say.
        answer: Whether it is the result of the work, which the display may be asked not to tell.
    """
    display = _DISPLAY.get()
    if display is not None and (display.answers or not answer):
        display.console.print(text, highlight=False, markup=False)


class _Count(ProgressColumn):
    """Pieces done of all, where their number is known."""

    def render(self, task: Task) -> Text:
        known = task.total is not None and task.total > 1
        return Text(f"{task.completed:.0f}/{task.total:.0f}" if known else "")


class _Left(ProgressColumn):
    """Time that is left, where it can be told and is worth telling."""

    def render(self, task: Task) -> Text:
        left = None if task.finished else task.time_remaining
        return Text("" if left is None or left < 1 else f"{timedelta(seconds=round(left))} left", "dim")
