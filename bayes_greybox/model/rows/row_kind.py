"""What a kind of rows is: how the rows of an equation are built from data."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.rows.path.reference_path import ReferencePath
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError

from .equation_rows import EquationRows


@runtime_checkable
class RunRows(Protocol):
    """Rows of runs that come one after another: together they are the rows of all runs at once."""

    def shared_rows(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> EquationRows:
        """The rows of some runs; none where these are too short for any.

        Args:
            data: The runs.
            equations: The learned states that share their rows.
            simulation: The known rates.
        """
        ...


class RowKind(ABC):
    """A kind of rows: by default rates that are measured beside all states, linear in whatever is added to them.

    Attributes:
        interpolation: Of the inputs between samples, where the rows take them there and free runs after them; None:
            each input's own.
    """

    interpolation: str | None = None

    @abstractmethod
    def rows(self, data: Trajectories, equation: str, simulation: Simulation) -> EquationRows:
        """The rows of one equation.

        Args:
            data: Measurements.
            equation: The learned state.
            simulation: The known rates.

        Raises:
            InputError: The data cannot give such rows.
        """

    def chosen(self, data: Trajectories) -> "RowKind":
        """The kind that rows of these data are of: this one, unless it leaves that to the data.

        Args:
            data: Training data.
        """
        return self

    def in_words(self, data: Trajectories) -> str:
        """What a row is, in a few words.

        Args:
            data: Measurements.
        """
        return "measured " + ("outputs" if data.output_names and not data.derivative_names else "rates")

    @property
    def rates_measured(self) -> bool:
        """Whether rows are rates, measured apart from the states; else they are samples of a path."""
        return True

    @property
    def studied(self) -> bool:
        """Whether explanations and errors of the sensors can be weighed on such rows."""
        return True

    @property
    def integrated(self) -> bool:
        """Whether rows follow a path that a model integrates, to which only an unknown force holds it while it is off.

        Rows that are linear near a model but hold to the samples by themselves follow none.
        """
        return False

    @property
    def starts(self) -> Mapping[str, str]:
        """Hidden states whose start is known: the column that each moves along with there; "" at rest."""
        return {}

    @property
    def shared(self) -> bool:
        """Whether all learned equations have the same rows, so that one likelihood tells of all; else each its own."""
        return False

    def shared_rows(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> EquationRows:
        """The rows of the equations that share them, which are named together; of one equation its `rows`.

        Args:
            data: Measurements.
            equations: The learned states.
            simulation: The known rates.

        Raises:
            InputError: The data cannot give such rows.
        """
        (equation,) = equations
        return self.rows(data, equation, simulation)

    def of_runs(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> RunRows:
        """What makes rows of further runs, with all that runs have in common as these have it.

        Args:
            data: Some runs.
            equations: The learned states that share their rows.
            simulation: The known rates.
        """
        return self

    def complete_all(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> Trajectories:
        """`complete` for the equations that share their rows."""
        (equation,) = equations
        return self.complete(data, equation, simulation)

    def hidden(self, simulation: Any, data: Trajectories) -> tuple[str, ...]:
        """States that the user's simulation has and the data lack, in order; none where rows need every state.

        Args:
            simulation: As the user gave it.
            data: Measurements.
        """
        return ()

    def complete(self, data: Trajectories, equation: str, simulation: Simulation) -> Trajectories:
        """Data with every state and the equation's rate at every sample, which terms and maps are evaluated on.

        Args:
            data: Measurements.
            equation: The learned state.
            simulation: The known rates.
        """
        return data

    def nodes(self, data: Trajectories, equation: str, simulation: Simulation, whole: bool = False) -> Trajectories:
        """States and inputs where the terms of the rows are evaluated, as data.

        Args:
            data: Measurements.
            equation: The learned state.
            simulation: The known rates.
            whole: Whether segments of a run are one run, or runs of their own.
        """
        return data

    def path(self, data: Trajectories, equations: tuple[str, ...], simulation: Simulation) -> ReferencePath:
        """The path that rows of samples are linear along.

        Args:
            data: Measurements.
            equations: The learned states.
            simulation: The known rates of all states.

        Raises:
            InputError: Rows of rates have none; no path was found.
        """
        raise InputError(
            "Rows of rates are linear in what is learned, so that their posterior is exact already, and follow no "
            "path: for samples use GreyBox(rows=bg.TrajectoryRows())."
        )

    def around(self, added: Sequence[tuple[Term, float]], to: Sequence[str] = ()) -> "RowKind":
        """The rows, if they are linear only near a model, near that with these terms and coefficients.

        Args:
            added: To the rate of the learned state, user's units.
            to: The learned state of each of these, where several share the rows.
        """
        return self

    def resting(self, states: Mapping[str, str], starts: Mapping[str, str]) -> "RowKind":
        """The rows, if they may have hidden states, where some are at rest where a run starts.

        Args:
            states: These, each with the column that it is about as large as.
            starts: Those of them that move along with a column where a run starts, with that column.
        """
        return self

    def from_afar(self, turn: int) -> "RowKind":
        """The rows as they are taken in a turn in which the model that they are linear near is found.

        Args:
            turn: How many turns there were before.
        """
        return self

    def moved_by(self, intensity: float) -> "RowKind":
        """The rows, if they are samples of a path, of one that an unknown force moves.

        Args:
            intensity: λ = q²/σ² of the force, σ the noise of a typical sensor, user's units.
        """
        return self

    def left_out(self, data: Trajectories) -> tuple[str, ...]:
        """What of the data is no row, in words.

        Args:
            data: Measurements.
        """
        return ()

    def unforced(self) -> "RowKind":
        """The rows, if they follow a path that an unknown force may move, along one that the model allows."""
        return self

    def segments(self, data: Trajectories) -> int:
        """How many segments each run of a path, if the rows follow one, is to be cut into at least.

        Args:
            data: Samples.
        """
        return 1

    def in_segments(self, segments: int, data: Trajectories) -> "RowKind":
        """The rows, if they follow a path, along one whose runs are cut into so many segments at least.

        Args:
            segments: Each with a start of its own.
            data: Samples of which there are to be so many; on others they are as long.
        """
        return self

    def held(self) -> "RowKind":
        """The rows, if they take inputs between samples, with every input held from each sample to the next."""
        return self
