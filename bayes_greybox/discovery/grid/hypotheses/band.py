"""The part of what is left in the frequency band of a force: only that can be mistaken for the force.

With p and q the spectra of the force and of what is left, each of sum one, averaged over the blocks of a record (Welch
1967, IEEE Trans. Audio Electroacoust. 15:70), its share is

    Σ_ω p q/Σ_ω p²,  at most 1.

It is 1 if both have the same spectrum. If what is left is white and the force has some frequencies evenly, it is the
share of the frequencies that the force has.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.signal.windows import hann

from .agreement import blocks


class Band:
    """Spectra of forces and of what is left beside hypotheses, over the blocks of a record.

    Args:
        forces: At samples in order of time [n_sample, n_force].
        left: What is left beside each hypothesis there [n_sample, n_hypothesis].
    """

    def __init__(
        self, forces: Float[np.ndarray, "n_sample n_force"], left: Float[np.ndarray, "n_sample n_left"]
    ) -> None:
        self._forces = _transformed(forces)
        self._left = _shares(_transformed(left), len(forces))
        self._n_sample = len(forces)

    def of(self, hypothesis: int, members: Sequence[int], mixed: Float[np.ndarray, "k k"]) -> Float[np.ndarray, " k"]:
        """Return the share of the square of what is left that has the spectrum of each of some sums of forces.

        Args:
            hypothesis: Number of the hypothesis whose remainder it is.
            members: Forces.
            mixed: Coefficients of the sums, one in each row. A sum that is zero has a share of 1.
        """
        p = _shares(self._forces[..., list(members)] @ mixed.T, self._n_sample)
        q, square = self._left[:, hypothesis], np.sum(p**2, axis=0)
        return np.clip(np.where(square > 0, (q @ p) / np.where(square > 0, square, 1.0), 1.0), 0.0, 1.0)


def _length(n: int) -> tuple[int, int]:
    """Return the number of blocks and how long each is."""
    n_block = int(blocks(n).max(initial=0)) + 1
    return n_block, n // n_block


def _transformed(table: np.ndarray) -> np.ndarray:
    """Return Fourier transforms of the blocks under a Hann window: their ends do not leap."""
    n_block, length = _length(len(table))
    cut = table[: n_block * length].reshape(n_block, length, -1) * hann(length, sym=False)[:, None]
    return np.fft.rfft(cut, axis=1)


def _shares(transformed: np.ndarray, n: int) -> Float[np.ndarray, "n_frequency k"]:
    """Return spectra over their sums."""
    power = np.sum(np.abs(transformed) ** 2, axis=0)
    # All frequencies but zero and half the rate of the samples stand for their negative, too.
    power[1 : (_length(n)[1] + 1) // 2] *= 2
    total = np.sum(power, axis=0)
    return power / np.where(total > 0, total, 1.0)
