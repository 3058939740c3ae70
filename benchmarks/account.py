"""Causes of a command's seconds: imports, tracing, compiling, sampling, checks, drawing, writing.

The stopwatch runs commands with it. Every second counts once, for the innermost thing that was going on: compiling
within a stage is compiling, and seconds outside all stages are the rest.
"""

import builtins
import json
import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

ACCOUNT = "BAYES_GREYBOX_ACCOUNT"
"""Environment variable: the file for the account, as JSON."""

STAGES = {
    "Starting": "reading", "Reading the data": "reading", "Reading the rows": "reading",
    "Weighing explanations": "weighing",
    "Compiling the sampler": "rest of the sampler", "Sampling": "sampling",
    "Sampling again, with finer features": "sampling", "Fitting without what is left out": "sampling",
    "Drawing coefficients and f": "exact draws", "Drawing from the prior": "exact draws",
    "Predicting the measurements": "predictions", "Predicting held-out data": "predictions",
    "Checking the model": "checks", "Comparing": "checks",
    "Drawing": "drawing",
    "Saving the fit": "writing", "Saving the study": "writing", "Writing the record": "writing",
    "Writing the report": "pages",
}  # fmt: skip
"""Kind that the time of a stage counts as, but for compiling in it."""

EVENTS = {
    "/jax/core/compile/jaxpr_trace_duration": "tracing",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "tracing",
    "/jax/core/compile/backend_compile_duration": "compiling",
    "/jax/compilation_cache/cache_retrieval_time_sec": "kept programs",
}
"""Events of JAX's compiling; the last is a program's way from the file."""

IMPORTS, REST = "imports", "rest"
"""Columns that are no stage's."""


class Interval(NamedTuple):
    """Something that was going on."""

    kind: str
    start: float
    end: float


def accounted(intervals: Iterable[Interval], total: Interval) -> dict[str, float]:
    """Return seconds by kind, each counted once, for the interval that began last of those that were open."""
    inside = [Interval(k, max(a, total.start), min(b, total.end)) for k, a, b in intervals]
    # Of two of the same length the first one counts.
    whole = [*(each for each in inside if each.end > each.start), total]
    edges = sorted({time for each in whole for time in each[1:]})
    seconds: dict[str, float] = {}
    for start, end in zip(edges, edges[1:], strict=False):
        open_ = [each for each in whole if each.start <= start and each.end >= end]
        # Of two that began together the shorter lies within the longer.
        kind = max(open_, key=lambda each: (each.start, -each.end)).kind
        seconds[kind] = seconds.get(kind, 0.0) + end - start
    return seconds


class Account(logging.Handler):
    """A listener to imports, to JAX and to stages."""

    def __init__(self) -> None:
        """Hear nothing yet."""
        super().__init__(logging.DEBUG)
        self.intervals: list[Interval] = []
        self._depth = threading.local()
        self._hears_jax = False

    def emit(self, record: logging.LogRecord) -> None:
        """Take down a stage that is over."""
        if isinstance(record.args, tuple) and len(record.args) == 2:
            text, seconds = record.args
            self._over(STAGES.get(str(text), REST), float(str(seconds)))

    def heard(self, event: str, seconds: float, **_: Any) -> None:
        """Take down an event of JAX that is over."""
        if event in EVENTS:
            self._over(EVENTS[event], seconds)

    def timed(self, importing: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap the function behind `import`, to time it; imports within imports are not counted apart."""

        def timed(*args: Any, **named: Any) -> Any:
            if getattr(self._depth, "inside", False):
                return importing(*args, **named)
            self._depth.inside, start = True, time.perf_counter()
            try:
                return importing(*args, **named)
            finally:
                self._depth.inside = False
                seconds = time.perf_counter() - start
                # A module that is there already costs microseconds, and there are thousands of those.
                if seconds > 1e-3:
                    self._over(IMPORTS, seconds)
                if not self._hears_jax and "jax.monitoring" in sys.modules:
                    self._hears_jax = True
                    sys.modules["jax.monitoring"].register_event_duration_secs_listener(self.heard)

        return timed

    def _over(self, kind: str, seconds: float) -> None:
        now = time.perf_counter()
        self.intervals.append(Interval(kind, now - seconds, now))


def account(command: Callable[[], int]) -> tuple[int, dict[str, float]]:
    """Run a command, and return its exit code and its seconds by kind, with those of all cores as "CPU"."""
    found = Account()
    log = logging.getLogger("bayes_greybox.running.stages")
    log.addHandler(found)
    log.setLevel(logging.DEBUG)
    log.propagate = False
    start, importing = time.perf_counter(), builtins.__import__
    builtins.__import__ = found.timed(importing)
    try:
        code = command()
    finally:
        builtins.__import__ = importing
    seconds = accounted(found.intervals, Interval(REST, start, time.perf_counter()))
    return code, {**seconds, "all": sum(seconds.values()), "CPU": time.process_time()}


def run(command: Callable[[], int]) -> int:
    """Run a command, write its account to the file that the environment names, and return its exit code."""
    code, seconds = account(command)
    with open(os.environ[ACCOUNT], "w", encoding="utf-8") as opened:
        json.dump({kind: round(value, 2) for kind, value in seconds.items()}, opened)
    return code
