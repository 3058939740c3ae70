"""All contenders by name."""

from collections.abc import Mapping
from dataclasses import dataclass

from benchmarks.speed.drawn import Draw
from benchmarks.speed.problems import PARTIAL, Problem

from . import by_hand, here, peers


@dataclass(frozen=True)
class Contender:
    """A way to draw.

    Attributes:
        draw: Sampler.
        most_rows: Rows N beyond which it is not asked: the covariance of N rows in memory for one.
        misses_f: True if it has no f, and so is not asked where terms are missing.
        of: Contender whose posterior it draws from, but for its features.
    """

    draw: Draw
    most_rows: int
    misses_f: bool = False
    of: str = "here"

    def runs(self, problem: Problem) -> bool:
        """Return True if it is asked about the problem."""
        return problem.n_obs <= self.most_rows and not (self.misses_f and problem.kind == PARTIAL)


CONTENDERS: Mapping[str, Contender] = {
    # θ, f integrated out; Laplace; projected cosines.
    "here": Contender(here.sample, 10**7),
    # θ sampled, f integrated out; projected exact kernel.
    "NumPyro exact": Contender(by_hand.exact, 1000),
    # θ, f sampled; projected sines.
    "NumPyro HSGP": Contender(by_hand.features, 10**5),
    # θ, f sampled; sines, not orthogonal: another posterior.
    "PyMC HSGP": Contender(peers.plain, 10**5),
    # θ, f sampled; projected sines.
    "PyMC projected": Contender(peers.projected, 10**5),
    # A horseshoe of its own, no f.
    "PySINDy SBR": Contender(peers.sbr, 10**6, misses_f=True, of="here, no f"),
    # Regularised horseshoe, no f.
    "here, no f": Contender(here.without_f, 10**7, misses_f=True, of="here, no f"),
}
"""Contenders in the order of the table."""
