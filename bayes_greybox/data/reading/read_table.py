"""Reader of tables under the name that came before `read`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from bayes_greybox.data.trajectories import Trajectories

from .door import read


def read_table(
    path: str | Path,
    *,
    time: str | None = None,
    states: Sequence[str] | Mapping[str, str] = (),
    inputs: Sequence[str] | Mapping[str, str] = (),
    derivatives: Mapping[str, str] | None = None,
    outputs: Sequence[str] | Mapping[str, str] = (),
    trajectory: str | None = None,
    dt: float | None = None,
    units: Mapping[str, str] | None = None,
    missing: Literal["error", "drop"] = "error",
    constant: Literal["error", "keep"] = "error",
) -> Trajectories:
    """Read one file of measurements: `read(path, run=trajectory, ...)`, which has more options.

    `path` is the `source` of `read`, and `trajectory` its `run`: the column whose value tells the runs apart. All
    other arguments are those of `read`.

    Raises:
        InputError: If the file or a column cannot be used; the message names it.
    """
    options = {"missing": missing, "constant": constant, "time": time, "dt": dt, "run": trajectory, "units": units}
    return read(path, states=states, inputs=inputs, derivatives=derivatives, outputs=outputs, **options)
