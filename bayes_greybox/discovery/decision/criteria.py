"""Every number of the decision that can flip a verdict."""

from dataclasses import dataclass

FEWEST_ROWS = 8
"""Fewest rows of a study: one for each of the six blocks that agreement is taken over, two for the start and the noise.

Of forty studies of eleven rows none names a wrong effect above 0.9 (docs/results/fields.md).
"""


@dataclass(frozen=True)
class Criteria:
    """Numbers that decide, each with where it comes from.

    Attributes:
        named: Probability, and agreement under bagging, from which on an effect is named: odds of nine.
        missing: Probability from which on something is missing, has a name, or remains: likelier than not.
        tied: Probability of a rival over that of an effect from which on the two are tied: odds of twenty.
        stacked: Probability that three effects of one quantity, or two of which one bends, are one law without a name:
            as likely as not.
        negligible: RMS of the discrepancy, over that of the modelled rate, below which simulation and measurement agree
            in practice: one per cent, a convention that the user may change.
        nameless: Share of the unknown's probability that comes from hypotheses without effects, above which a small
            discrepancy is negligible: most of it.
        remainder: Share of the gap's square beside named effects from which on they name only a part of it: one per
            cent, a convention.
        level: p-value below which a check speaks against a verdict: each check doubts one right answer in a thousand.
        checked_rows: Rows from which on residuals are checked: twice the most lags of the whiteness test.
        reversed: Probability of the unusual sign of an effect's coefficient from which on it is reported: odds of
            nineteen.
        worse: Relative growth of a free run's error from which on it counts as worse: a convention.
        integrator: Error of a free run, over the measurement's standard deviation, that is none: the integrator's own.
        misfit: Misfit of held-out samples, over that of training samples, from which on the answer fails there: half as
            large again, a convention.
        forced: Factor by which held-out noise may exceed the training noise beside a latent force, which moves one
            record for longer than another: a convention.
        bend: Second difference of an effect within reach of a filtered sample, over its RMS, from which on rates do not
            show its shape there: a convention.
        bent_rows: Share of the samples that may bend so: single ones are chance.
        end: Share of the logarithm of a parameter's range that is its end; a flat posterior has as much there.
        at_end: Share of the draws at one end above which the value may lie beyond: most of them.
    """

    named: float = 0.9
    missing: float = 0.5
    tied: float = 0.05
    stacked: float = 0.5
    negligible: float = 0.01
    nameless: float = 0.5
    remainder: float = 0.01
    level: float = 1e-3
    checked_rows: int = 40
    reversed: float = 0.95
    worse: float = 0.02
    integrator: float = 1e-4
    misfit: float = 1.5
    forced: float = 2.0
    bend: float = 0.25
    bent_rows: float = 0.005
    end: float = 0.05
    at_end: float = 0.5


CRITERIA = Criteria()
"""Criteria of a study that sets none of its own."""
