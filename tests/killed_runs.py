"""Kill `bayes-greybox fit` at random moments, go on with --resume, and compare with a run that nobody stopped.

    python tests/killed_runs.py KILLS [SEED [DRAWS]]

The command runs in forks of this process, which has imported the package and woken nothing, so that a run takes
seconds; a kill is a SIGKILL at a moment drawn evenly over the processor time that a whole run takes.
"""

import json
import os
import signal
import sys
import tempfile
import time
import tomllib
from pathlib import Path

import arviz_stats.base.array  # noqa: F401 - imported here, once for all forks, as all that a run imports late
import dask.array  # noqa: F401
import distributed  # noqa: F401
import numpy as np
import pandas as pd
import xarray as xr

from bayes_greybox import cli
from bayes_greybox.cli import fitting  # noqa: F401
from bayes_greybox.data.reading.units import registry
from bayes_greybox.running.whole_files import PART_PREFIX

CONFIG = """
[data]
path = "run.csv"
time = "t"
states = ["y", "z"]
derivatives = { y = "rate" }

[dictionary]
y = ["y"]

[prior]
kind = "normal"

[discrepancy]
variables = ["y"]
features = 4
boundary = 1.5

[sampling]
draws = %d
tune = %d
chains = 2

[output]
folder = "out"
figures = false
checkpoint_every = 0.0
"""
"""A checkpoint after every piece: as many moments as there can be at which one is being written.

The second state has no equation, so that nothing is integrated, which would take longer than the sampling.
"""


def prepare(folder: Path, draws: int = 600) -> None:
    """A table and a configuration, of twice as many iterations of warm-up as there are draws."""
    y = np.linspace(-1.0, 1.0, 20)
    rate = -y + 0.05 * np.random.default_rng(0).standard_normal(len(y))
    columns = {"t": np.arange(len(y)) * 0.1, "y": y, "z": y**2, "rate": rate}
    pd.DataFrame(columns).to_csv(folder / "run.csv", index=False)
    (folder / "case.toml").write_text(CONFIG % (draws, 2 * draws))


def start(*words: str) -> int:
    """Run the command in a fork, and return its process."""
    process = os.fork()
    if process == 0:
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        # 3: so few draws do not converge.
        code = cli.main(["fit", "case.toml", "--quiet", *words])
        os._exit(0 if code in (0, 3) else 1)
    return process


def finish(process: int) -> None:
    """Wait for a run that must succeed."""
    status = os.waitpid(process, 0)[1]
    assert os.waitstatus_to_exitcode(status) == 0, status


def kill_at(moment: float, process: int) -> bool:
    """Kill a run once it has worked for so many seconds; False where it was done before."""
    while True:
        ended, status = os.waitpid(process, os.WNOHANG)
        if ended:
            assert os.waitstatus_to_exitcode(status) == 0, status
            return False
        stat = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        if (int(stat[11]) + int(stat[12])) / os.sysconf("SC_CLK_TCK") >= moment:
            # Clocks of processes tick a hundred times a second.
            time.sleep(0.01 * (moment * 1e4 % 1))
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
            return True
        time.sleep(0.01)


def require_whole(folder: Path) -> None:
    """Every file that has its name can be read."""
    for file in folder.rglob("*"):
        if file.is_dir() or file.name.startswith((PART_PREFIX, ".lock")) or PART_PREFIX in str(file.parent):
            continue
        if file.suffix == ".npz":
            with np.load(file, allow_pickle=False) as found:
                assert all(found[name] is not None for name in found)
        elif file.suffix == ".json":
            json.loads(file.read_text())
        elif file.suffix == ".toml":
            tomllib.loads(file.read_text())
        else:
            assert file.suffix == ".nc", file
            xr.open_datatree(file, engine="h5netcdf").load().close()


def require_same(folder: Path, reference: Path) -> None:
    """The files of a complete run, and in them the draws of the other one."""
    assert sorted(path.name for path in folder.iterdir()) == ["config.toml", "run.nc", "summary.json"]
    require_same_draws(folder / "run.nc", reference / "run.nc")


def require_same_draws(file: Path, reference: Path) -> None:
    """The draws of two files are the same to the last bit."""
    one, other = (xr.open_datatree(each, engine="h5netcdf").load() for each in (file, reference))
    for group in ("posterior", "sample_stats", "prior", "log_prior"):
        assert one[group].to_dataset().equals(other[group].to_dataset()), group


def killed(kills: int, seed: int = 0, draws: int = 600, at_most: int = 8) -> list[float]:
    """Moments of so many kills, as shares of a whole run, after each of which the run went on to the same draws.

    Args:
        kills: How many; a run is killed `at_most` times before it is left to finish.
        seed: Of the moments.
        draws: Of each chain.
        at_most: Kills of one run.
    """
    prepare(Path(), draws)
    registry()
    finish(start("--output", "warm"))
    begin = os.times()
    finish(start("--output", "reference"))
    end = os.times()
    whole = end.children_user + end.children_system - begin.children_user - begin.children_system
    moments, generator = [], np.random.default_rng(seed)
    while len(moments) < kills:
        folder = Path(f"run-{len(moments)}")
        resume: list[str] = []
        for _ in range(min(at_most, kills - len(moments))):
            moment = generator.uniform(0.0, whole)
            if not kill_at(moment, start("--output", str(folder), *resume)):
                break
            moments.append(moment / whole)
            resume = ["--resume"]
            require_whole(folder)
        else:
            finish(start("--output", str(folder), *resume))
        require_same(folder, Path("reference"))
        print(f"{len(moments)} of {len(moments)} kills: the same draws", flush=True)
    return moments


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        os.chdir(place)
        killed(*map(int, sys.argv[1:]))
