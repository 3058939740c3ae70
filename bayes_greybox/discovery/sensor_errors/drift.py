"""Forces that change with time: a coefficient that is another one at the end of a record than at its start.

A spring warms up, a bolt comes loose, a battery sags. Where a motion dies away meanwhile, its amplitude and the time go
together, and a law of the amplitude passes for one of the time. Each element

    z = x exp(−(t − t₀)/τ)

is a coefficient of x that settles, or, where τ is longer than the record, one that goes on changing; t₀ is where the
record starts. A coefficient of x that does not change is a correction of the simulation.
"""

import numpy as np

from bayes_greybox.data.trajectories import Trajectories

from .channels import DRIFT
from .memory import Chosen, Memories, Memory, everything

SETTLING = (0.08, 0.14, 0.25, 0.45, 0.8, 2.0)
"""Time constants τ over the duration of the record."""


def drift_columns(data: Trajectories, chosen: Chosen = everything) -> Memories:
    """Yield every state and input times each of the ways of settling, one element each.

    Runs that go on at the time at which others ended belong to one record.
    """
    since = data.time - np.min(data.time)
    duration = np.max(since)
    if duration <= 0:
        return
    for name in (*data.state_names, *data.input_names):
        for share in SETTLING if chosen(Memory(DRIFT, name).text) else ():
            yield Memory(DRIFT, name, share), (data.column(name) * np.exp(-since / (share * duration)))[:, None]
