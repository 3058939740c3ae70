"""Whether another commit gives the same posteriors.

    python .ci/same_posterior.py COMMIT [CONFIG ...]

Fits each configuration with the code of that commit and with this checkout's, same seed, and prints the largest
difference of every group of the results, relative to the largest number of its variable. Above 1e-10 it fails.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import xarray as xr

CONFIGS = ("first", "paper_partial_orthogonal", "prior_regularised_horseshoe")
"""One for each of three priors: spike-and-slab, Laplace, horseshoe."""

TOLERANCE = 1e-10
FIT = "import sys; from bayes_greybox.cli import main; sys.exit(main(sys.argv[1:]))"


def fit(checkout: Path, config: str, folder: Path) -> Path:
    """Fit a configuration with the code of a checkout; the sampler's verdict on so short a run does not matter."""
    settings = ["--draws", "200", "--tune", "200", "--chains", "2", "-q", "-o", str(folder)]
    environment = {**os.environ, "PYTHONPATH": str(checkout)}
    command = [sys.executable, "-c", FIT, "fit", str(checkout / "configs" / f"{config}.toml"), *settings]
    if subprocess.run(command, cwd=checkout, env=environment, check=False).returncode not in (0, 3):
        raise SystemExit(f"{config} cannot be fitted with {checkout}")
    return folder / "run.nc"


def with_details(tree: xr.DataTree, group: str) -> xr.Dataset:
    """A group and its details, which older files have in one."""
    details = tree.children.get(f"{group}_details")
    return tree[group].to_dataset() if details is None else tree[group].to_dataset().assign(details.data_vars)


def differences(one: Path, other: Path) -> dict[str, float]:
    """Largest relative difference of each group."""
    found = {}
    with xr.open_datatree(one) as first, xr.open_datatree(other) as second:
        for group in first.children:
            if group.endswith("_details"):
                continue
            before, now = (with_details(tree, group) for tree in (first, second))
            if set(before) != set(now):
                raise SystemExit(f"{group} has other variables: {sorted(map(str, set(before) ^ set(now)))}")
            found[group] = 0.0
            for name in before:
                x, y = before[name].to_numpy().astype(float), now[name].to_numpy().astype(float)
                size = max(float(np.nanmax(np.abs(x), initial=0.0)), 1e-300)
                found[group] = max(found[group], float(np.nanmax(np.abs(x - y), initial=0.0)) / size)
    return found


def main() -> int:
    """Compare."""
    commit, *configs = sys.argv[1:]
    here = Path(__file__).resolve().parents[1]
    worst = 0.0
    with tempfile.TemporaryDirectory() as folder:
        there = Path(folder) / "checkout"
        subprocess.run(["git", "worktree", "add", "--detach", "-f", str(there), commit], cwd=here, check=True)
        try:
            for config in configs or CONFIGS:
                files = [fit(tree, config, Path(folder) / f"{config}-{i}") for i, tree in enumerate((there, here))]
                found = differences(*files)
                worst = max(worst, *found.values())
                print(config, *(f"{group} {value:.1e}" for group, value in found.items()), sep="  ", flush=True)
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", str(there)], cwd=here, check=True)
    return int(worst > TOLERANCE)


if __name__ == "__main__":
    sys.exit(main())
