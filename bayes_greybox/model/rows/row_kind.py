"""The interface of a kind of rows: how the rows of an equation are built from data."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar, cast
from weakref import WeakKeyDictionary

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.rows.path.reference_path import ReferencePath
from bayes_greybox.physics.integration.adaptive_steps import INTERPOLATIONS
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.physics.simulation.reading import named_states
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError

from .equation_rows import EquationRows

Result = TypeVar("Result")


class Remembered:
    """The latest four results for each of some samples, as the same ones are asked for several times in a row."""

    def __init__(self) -> None:
        self._results: WeakKeyDictionary[Trajectories, dict[Any, Any]] = WeakKeyDictionary()
        self._lock = threading.Lock()

    def result(self, samples: Trajectories, key: Any, compute: Callable[[], Result]) -> Result:
        """Return the result for some samples under a key, computed unless it is remembered."""
        results = self._results.setdefault(samples, {})
        found = results.get(key)
        if found is None:
            found = compute()
            with self._lock:
                while len(results) >= 4:
                    del results[next(iter(results))]
                results[key] = found
        return found


RowsOfRuns = Callable[[Trajectories, tuple[str, ...], Simulation], EquationRows]
"""Function from runs, their learned states and the known rates to rows, none where the runs are too short for any; rows
of runs that come one after another are together the rows of all runs at once."""


def checked_interpolation(kind: str, given: Any) -> str | tuple[str, ...] | None:
    """Return the interpolation of inputs that rows of a kind were given: a known one, for all or for each."""
    each = tuple(given) if isinstance(given, list) else given
    names = each if isinstance(each, tuple) and each else (each,)
    if each is not None and not all(isinstance(name, str) and name in INTERPOLATIONS for name in names):
        raise InputError(
            f"{kind}(interpolation={given!r}) must be one of {', '.join(INTERPOLATIONS)}, or one of these for each "
            "input."
        )
    return each


class RowKind(ABC):
    """A kind of rows: by default measured rates beside all states, linear in whatever is added to them.

    A kind has a method `rows`, or `shared_rows` where all equations share them.

    Arguments of the methods have the same meaning throughout: `data` are measurements, `equation` or `equations` the
    learned states that the rows tell of, and `simulation` the known rates.

    Attributes:
        interpolation: Interpolation of the inputs between samples, one for all or for each, where the rows take them
            there and free runs after them; None: chosen for each input.
        linear: If true, the rows are linear in what is learned wherever it is; else they are taken near a model.
        shared: If true, all learned equations have the same rows, so that one likelihood tells of all.
        follows_path: If true, the rows follow a path that a model integrates. Such a kind has the methods `unforced`,
            `segments` and `in_segments` of `TrajectoryRows` too. A kind that is neither linear nor follows a path has
            `from_afar`, as `WeakRows`. Both have the fields `added` and `added_to`.
        studied: If true, hypotheses and sensor errors can be weighed on the rows.
    """

    interpolation: str | tuple[str, ...] | None = None
    linear: bool = True
    shared: bool = False
    follows_path: bool = False
    studied: bool = True

    @abstractmethod
    def rows(self, data: Trajectories, equation: str, simulation: Simulation) -> EquationRows:
        """Return the rows of one equation."""

    def shared_rows(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> EquationRows:
        """Return the rows of equations that share them; see `rows`."""
        (equation,) = equations
        return self.rows(data, equation, simulation)

    def of_runs(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> RowsOfRuns:
        """Return a function to rows of further runs, which share with these all that runs have in common."""
        return self.shared_rows

    def chosen(self, data: Trajectories) -> "RowKind":
        """Return the kind of rows for training data: this one, unless it leaves that to the data."""
        return self

    def in_words(self, data: Trajectories) -> str:
        """Return in a few words what a row is."""
        return "measured " + ("outputs" if data.output_names and not data.derivative_names else "rates")

    def left_out(self, data: Trajectories) -> tuple[str, ...]:
        """Return sentences on what of the data is no row."""
        return ()

    def hidden(self, simulation: Any, data: Trajectories) -> tuple[str, ...]:
        """Return the states of a simulation, as the user gave it, that the data lack; none where rows need them all."""
        if self.linear:
            return ()
        if data.output_names:
            raise InputError(
                f"Rows of samples are those of states, and {data.output_names[0]!r} is an output: leave it out of "
                "outputs=..., or use GreyBox(rows=bg.DerivativeRows()), whose states are measured."
            )
        return tuple(name for name in named_states(simulation) if name not in data.columns)

    @property
    def starts(self) -> Mapping[str, str]:
        """Hidden states with a known start: the column that each moves along with there; "" at rest."""
        return {}

    def complete(self, data: Trajectories, equation: str, simulation: Simulation) -> Trajectories:
        """Return the data with every state and the equation's rate at every sample, which terms are evaluated on."""
        return self.complete_all(data, (equation,), simulation)

    def complete_all(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> Trajectories:
        """Return the data completed for equations that share their rows; see `complete`."""
        return data

    def nodes(self, data: Trajectories, equation: str, simulation: Simulation, whole: bool = False) -> Trajectories:
        """Return states and inputs where terms are evaluated, as data; if `whole`, segments of a run are one run."""
        return data

    def path(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> ReferencePath:
        """Return the path that the rows are linear along, or refuse where they follow none or none is found."""
        raise InputError(
            "Rows of rates are linear in what is learned, so that their posterior is exact already, and follow no "
            "path: for samples use GreyBox(rows=bg.TrajectoryRows())."
        )

    def around(self, added: Sequence[tuple[Term, float]], to: Sequence[str] = ()) -> "RowKind":
        """Return the rows near the model with these terms and coefficients, added `to` the rates of learned states."""
        if self.linear:
            return self
        texts = tuple((term.text, float(value)) for term, value in added)
        return replace(cast(Any, self), added=texts, added_to=tuple(to))

    def resting(self, states: Mapping[str, str], starts: Mapping[str, str]) -> "RowKind":
        """Return the rows with hidden states that are at rest where a run starts, or as the column in `starts`.

        Each state has the column that it is about as large as.
        """
        return self

    def moved_by(self, intensity: float) -> "RowKind":
        """Return the rows of a path that an unknown force moves, of intensity λ = q²/σ², σ a typical sensor's noise."""
        return self

    def held(self, data: Trajectories) -> tuple[str, ...]:
        """Return the inputs that are held between the nodes of the rows; a path has nodes on both sides of a leap."""
        return ()

    def between(self, interpolation: str | tuple[str, ...]) -> "RowKind":
        """Return the rows with an interpolation of the inputs between samples, one for all or for each."""
        return self
