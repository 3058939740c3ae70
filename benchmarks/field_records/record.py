"""Types of the records: what was measured, how its owner would study it, and what would be right."""

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, field

import numpy as np

NO_GAP, INSTRUMENT, RECALIBRATE = "no gap", "instrument", "recalibrate"
NAMED, ONE_OF, PARTLY, UNKNOWN = "named", "one of", "partly named", "unknown"

Column = np.ndarray | Sequence[np.ndarray]
"""Values at the samples; a list has one array for each run."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements, and the simulation of them.

    Attributes:
        time: Sampling times.
        inputs: Measured inputs by name.
        units: Units by name, those of the time "t" among them.
        simulation: Formulas by state or output.
        parameters: Values of the parameters as they are written down.
        states: Measured states by name.
        outputs: Measured outputs by name.
        starts: Starts of states that nothing measures.
        roles: Columns by role, beyond those that the study sees by itself.
        held: If true, the owner says that inputs are held between samples.
        split: Share of the record to study, of which the rest is held out; None studies all of it.
    """

    time: Column
    inputs: Mapping[str, Column]
    units: Mapping[str, str]
    simulation: Mapping[str, str]
    parameters: Mapping[str, float]
    states: Mapping[str, Column] = field(default_factory=dict)
    outputs: Mapping[str, Column] = field(default_factory=dict)
    starts: Mapping[str, float] = field(default_factory=dict)
    roles: Mapping[str, str] = field(default_factory=dict)
    held: bool = False
    split: float | None = None


@dataclass(frozen=True, eq=False)
class FieldRecord:
    """A record, its truth, and the right answers, which were fixed before any study.

    Attributes:
        name: Name of the record.
        kind: Field, which is also the catalogue of its study.
        seed: Seed of its draws.
        truth: What the simulation lacks, and how it was measured, in words.
        make: Function from a random generator to what was measured.
        verdicts: Acceptable verdicts.
        right: Slugs of effects that are right.
        harmless: Slugs that are not right, and not absurd; any other name is wrong.
        errors: Errors of the measurement that are there, such as "offset of i"; any other is wrong.
    """

    name: str
    kind: str
    seed: int
    truth: str
    make: Callable[[np.random.Generator], Measured]
    verdicts: Set[str]
    right: Set[str] = frozenset()
    harmless: Set[str] = frozenset()
    errors: Set[str] = frozenset()

    def measured(self) -> Measured:
        """Return what was measured, the same at every call."""
        return self.make(np.random.default_rng(self.seed))
