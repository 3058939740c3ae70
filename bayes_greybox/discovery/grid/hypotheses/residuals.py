"""Residuals of hypotheses taken apart: the discrepancy that a noise point has, and white noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_greybox.discovery.grid.evidence.gram import Basis, discrepancy_basis
from bayes_greybox.discovery.grid.noise.latent_force import LatentForce
from bayes_greybox.discovery.grid.noise.points import LAW, MEMORY, SENSOR, TIME, NoisePoint
from bayes_greybox.discovery.grid.table import RegressorTable


@dataclass(frozen=True)
class Pieces:
    """Residuals of hypotheses, taken apart under noise points.

    Attributes:
        table: Target and regressors.
        forces: The rows under each shape of the noise.
        points: Noise points.
        bases: Those of laws and memories that were asked for before.
    """

    table: RegressorTable
    forces: Sequence[LatentForce]
    points: Sequence[NoisePoint]
    bases: dict[tuple, Basis]

    def white(self, number: int, residuals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return residuals without the smoothed discrepancy of a law, whitened, and log variances of the rows."""
        point = self.points[number]
        if point.kind in (TIME, SENSOR):
            force, sensor = self.forces[point.shape], point.kind == SENSOR
            white, logs = force.whiten(residuals, point.scale, np.array([point.ratio]), sensor)
            return white[:, 0], logs
        white, logs = self.forces[point.shape].whiten(residuals, 1.0, np.zeros(1))
        white = white[:, 0]
        if point.kind in (LAW, MEMORY):
            basis = self._basis(point)
            white = white - basis.features @ basis.posterior(white, point.ratio)
        return white, logs

    def smoothed(self, number: int, residuals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the posterior mean of the discrepancy, as a force, and its variance over v."""
        point = self.points[number]
        if point.kind == TIME:
            return self.forces[point.shape].smooth(residuals, point.scale, point.ratio)
        basis = self._basis(point)
        white = self.forces[point.shape].whiten(residuals, 1.0, np.zeros(1))[0][:, 0]
        variance = basis.acting**2 @ (point.ratio**2 / (1 + point.ratio**2 * basis.eigenvalues))
        return basis.acting @ basis.posterior(white, point.ratio), variance

    def block_logs(self, best: np.ndarray, residuals: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the log likelihood of each block at each hypothesis's mode [n_hypothesis, n_block]."""
        member = (self.table.block == np.arange(self.table.block.max() + 1)[:, None]).astype(float)
        logs = np.empty((residuals.shape[1], len(member)))
        for number in np.unique(best):
            own = np.flatnonzero(best == number)
            white, spread = self.white(int(number), residuals[:, own])
            each = -0.5 * (white**2 / v[own] + np.log(v[own]) + spread)
            logs[own] = (member @ each).T
        return logs

    def remainder(self, logs: np.ndarray, residuals: np.ndarray) -> np.ndarray:
        """Return the smoothed discrepancy beside each hypothesis, at its likeliest point that has one."""
        remains = np.array([point.remains for point in self.points])
        best = np.argmax(np.where(remains, logs, -np.inf), axis=1)
        found = np.zeros((len(self.table.acting), len(best)))
        # Where each one would be larger than the gap there is none.
        for number in np.unique(best[remains[best]]):
            own = np.flatnonzero(best == number)
            found[:, own] = self.smoothed(int(number), residuals[:, own])[0]
        return found

    def _basis(self, point: NoisePoint) -> Basis:
        key = point.shape, point.kind, point.scale, point.memory
        if key not in self.bases:
            table = self.table
            if point.shape:
                table = replace(table, force=self.forces[point.shape])
            self.bases[key] = discrepancy_basis(table, point)
        return self.bases[key]
