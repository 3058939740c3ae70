"""All contenders by name."""

from collections.abc import Mapping
from dataclasses import dataclass

from benchmarks.speed.drawn import Draw
from benchmarks.speed.problems import PARTIAL, Problem

from . import by_hand, here, sbr, with_pymc


@dataclass(frozen=True)
class Contender:
    """A way to draw.

    Attributes:
        draw: At work.
        says: Prior and kernel, where they are not those of the first.
        most_rows: Rows N beyond which it is not asked: the covariance of N rows in memory for one.
        misses_f: Whether it has no f, and so is not asked where terms are missing.
        of: The contender whose posterior it draws from, but for its features.
    """

    draw: Draw
    says: str
    most_rows: int
    misses_f: bool = False
    of: str = "here"

    def runs(self, problem: Problem) -> bool:
        """Whether it is asked."""
        return problem.n_obs <= self.most_rows and not (self.misses_f and problem.kind == PARTIAL)


CONTENDERS: Mapping[str, Contender] = {
    "here": Contender(here.sample, "θ, f integrated out; Laplace; projected cosines", 10**7),
    "NumPyro exact": Contender(by_hand.exact, "θ sampled, f integrated out; projected exact kernel", 1000),
    "NumPyro HSGP": Contender(by_hand.features, "θ, f sampled; projected sines", 10**5),
    "PyMC HSGP": Contender(with_pymc.plain, "θ, f sampled; sines, not orthogonal: another posterior", 10**5),
    "PyMC projected": Contender(with_pymc.projected, "θ, f sampled; projected sines", 10**5),
    "PySINDy SBR": Contender(sbr.sample, "horseshoe of its own, no f", 10**6, misses_f=True, of="here, no f"),
    "here, no f": Contender(here.without_f, "regularised horseshoe, no f", 10**7, misses_f=True, of="here, no f"),
}
"""In the order of the table."""
