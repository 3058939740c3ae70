"""Instances of FMI 3.0 with the calls of FMI 2.0, by which the others of this folder run an FMU."""

from collections import deque
from collections.abc import Sequence
from typing import Any

from .description import Description


class Instance3:
    """An instance of FMI 3.0 as FMPy has it; calls that both versions share go to it as they are.

    Args:
        description: Description of the FMU.
        messages: Queue for its messages.
    """

    def __init__(self, description: Description, messages: deque[str]) -> None:
        from fmpy.fmi3 import FMU3Model, FMU3Slave

        self._fmu: Any = (FMU3Model if description.exchanged else FMU3Slave)(
            guid=description.guid,
            unzipDirectory=str(description.folder),
            modelIdentifier=description.interface.identifier,
            instanceName=description.name,
        )
        self._messages, self._experiment = messages, {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._fmu, name)

    def instantiate(self) -> None:
        """Instantiate it."""

        def heard(environment: Any, status: int, category: bytes, message: bytes) -> None:
            if status > 1 and message:
                self._messages.append(message.decode("utf-8", "replace").strip())

        self._fmu.instantiate(logMessage=heard)

    def setupExperiment(self, tolerance: float | None = None, startTime: float = 0.0) -> None:  # noqa: N802, N803
        """Keep what the initialisation is told."""
        self._experiment = {"tolerance": tolerance, "startTime": startTime}

    def enterInitializationMode(self) -> None:  # noqa: N802
        """Begin the initialisation."""
        self._fmu.enterInitializationMode(**self._experiment)

    def newDiscreteStates(self) -> tuple[Any, ...]:  # noqa: N802
        """Iterate an event."""
        return self._fmu.updateDiscreteStates()

    def getReal(self, refs: Sequence[int]) -> list[float]:  # noqa: N802
        """Return values of variables."""
        return self._fmu.getFloat64(refs)

    def setReal(self, refs: Sequence[int], values: Sequence[float]) -> None:  # noqa: N802
        """Set values of variables."""
        self._fmu.setFloat64(refs, values)
