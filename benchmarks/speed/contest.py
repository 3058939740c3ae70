"""One contender on one problem in a process of its own, which nothing was compiled for: its draws and its costs.

    python -m benchmarks.speed.contest FOLDER

is what the process runs; the folder has the task, and gets the draws.
"""

import math
import os
import pickle
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.account import account

from .contenders.listed import CONTENDERS
from .drawn import Drawn, Settings
from .problems import Data

TASK, DRAWN = "task.pickle", "drawn.pickle"
"""Files of the folder."""

STARTING = ("imports", "tracing", "compiling", "kept programs")
"""Kinds of seconds that a process spends before it draws."""

GRACE = 15.0
"""Seconds beyond the cap after which a process that looks at no clock is ended."""


def contest(folder: Path, contender: str, data: Data, settings: Settings) -> tuple[Drawn | None, dict[str, Any]]:
    """Return draws of a contender, and their costs.

    Returns:
        The draws, None where it was ended; and `seconds` since its process started, `cpu` seconds of all cores,
        `starting` seconds (the interpreter, imports, tracing, compiling), `memory` in MB at its peak, `capped`, and
        `failed`, its last line where it failed.
    """
    (folder / TASK).write_bytes(pickle.dumps((contender, data, settings)))
    kept = folder / "compiled"
    environment = {
        **{name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"},
        # Nothing that another process compiled.
        "BAYES_GREYBOX_CACHE": "off", "NUMBA_CACHE_DIR": str(kept), "PYTENSOR_FLAGS": f"base_compiledir={kept}",
        "JAX_ENABLE_X64": "1", "JAX_PLATFORMS": "cpu",
    }  # fmt: skip
    words = [sys.executable, "-m", __name__, str(folder)]
    start = time.time()
    with (folder / "said.txt").open("w", encoding="utf-8") as said:
        process = subprocess.Popen([*words, repr(start)], env=environment, stdout=said, stderr=said)
        try:
            process.wait(settings.cap + GRACE)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL if os.name == "posix" else signal.SIGTERM)
            process.wait()
            return None, {"seconds": time.time() - start, "capped": True, "failed": ""}
        except BaseException:
            process.kill()
            raise
    if process.returncode:
        last = (folder / "said.txt").read_text(encoding="utf-8", errors="replace").strip().splitlines()[-1:]
        failed = "".join(last) or f"ended with {process.returncode}"
        return None, {"seconds": time.time() - start, "capped": False, "failed": failed}
    drawn, numbers = pickle.loads((folder / DRAWN).read_bytes())
    return drawn, {**numbers, "capped": drawn.looks[-1][1] < settings.draws, "failed": ""}


def work(folder: Path, started: float) -> int:
    """Do the task of the folder in this process, which was asked for at a `time.time()`."""
    entered = time.time() - started
    contender, data, settings = pickle.loads((folder / TASK).read_bytes())
    found, costs = [], {}

    def draw() -> int:
        found.append(CONTENDERS[contender].draw(data, settings, lambda: time.time() - started))
        costs.update(_costs())
        return 0

    seconds = account(draw)[1]
    (drawn,) = found
    numbers = {
        **costs,
        "seconds": drawn.looks[-1][0],
        "starting": entered + drawn.compiling + math.fsum(seconds.get(kind, 0.0) for kind in STARTING),
    }
    (folder / DRAWN).write_bytes(pickle.dumps((drawn, numbers)))
    return 0


def _costs() -> dict[str, float]:
    """Return CPU seconds and peak memory of this process."""
    import resource  # there is none on Windows

    used = resource.getrusage(resource.RUSAGE_SELF)
    # Bytes on macOS, else kilobytes.
    return {"cpu": used.ru_utime + used.ru_stime, "memory": used.ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)}


if __name__ == "__main__":
    sys.exit(work(Path(sys.argv[1]), float(sys.argv[2])))
