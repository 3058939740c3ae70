"""Every number that can flip a verdict."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Criteria:
    """Numbers that decide, each with where it comes from.

    Attributes:
        named: Probability, and agreement of the data with themselves, from which on an effect is named: odds of nine.
        missing: Probability from which on something is missing, has a name, or remains: what is likelier than not.
        tied: Share of an effect's probability from which on another one in its place is tied with it: odds of twenty.
        stacked: Probability that three effects of one quantity, or two of which one bends, are one law without a name:
            as likely as not.
        negligible: RMS of what remains, over that of the modelled rate, below which simulation and measurement agree in
            practice.
        remainder: Share of the gap's square beside named effects from which on they name only a part of it.
        level: p-value below which a check speaks against a verdict: of a thousand right answers one is doubted.
        reversed: Probability of the other sign than an effect's usual one from which on that is said: odds of twenty.
        worse: Share of its error by which a free run may grow before it counts as worse: what numerics move.
        misfit: Misfit of held-out samples, over that of training samples, from which on the answer does not hold there.
        end: Share of the logarithm of a parameter's range that is its end; a flat posterior has as much there.
        at_end: Share of the draws at one end above which the value may lie beyond: most of them.
    """

    named: float = 0.9
    missing: float = 0.5
    tied: float = 0.05
    stacked: float = 0.5
    negligible: float = 0.01
    remainder: float = 0.01
    level: float = 1e-3
    reversed: float = 0.95
    worse: float = 0.02
    misfit: float = 1.5
    end: float = 0.05
    at_end: float = 0.5
