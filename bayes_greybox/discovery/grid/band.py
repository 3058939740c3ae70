"""What is left in the band of a force: only that can be mistaken for it.

With p and q the spectra of a force and of what is left, each of sum one, averaged over the blocks of a record (Welch
1967, IEEE Trans. Audio Electroacoust. 15:70), the share of the latter that has the spectrum of the former is

    Σ_ω p q/Σ_ω p²,  at most 1:

1 where both have one spectrum, and the share of frequencies that the force has where what is left has all of them.
"""

import numpy as np
from jaxtyping import Float
from scipy.signal.windows import hann

from .agreement import blocks


def in_band(
    left: Float[np.ndarray, "n_sample n_left"], forces: Float[np.ndarray, "n_sample n_force"]
) -> Float[np.ndarray, "n_left n_force"]:
    """Return the share of the square of what is left that has the spectrum of a force.

    Args:
        left: What is left, at samples in order of time.
        forces: Forces there; what is none, all zero, takes all that is left.
    """
    p, q = _spectra(forces), _spectra(left)
    square = np.sum(p**2, axis=0)
    return np.clip(np.where(square > 0, (q.T @ p) / np.where(square > 0, square, 1.0), 1.0), 0.0, 1.0)


def _spectra(table: np.ndarray) -> Float[np.ndarray, "n_frequency k"]:
    """Return spectra over their sums, of blocks without their leaps at both ends."""
    n_block = int(blocks(len(table)).max(initial=0)) + 1
    length = len(table) // n_block
    cut = table[: n_block * length].reshape(n_block, length, -1) * hann(length, sym=False)[:, None]
    power = np.sum(np.abs(np.fft.rfft(cut, axis=1)) ** 2, axis=0)
    # Frequencies between zero and the highest stand for two.
    power[1 : (length + 1) // 2] *= 2
    total = np.sum(power, axis=0)
    return power / np.where(total > 0, total, 1.0)
