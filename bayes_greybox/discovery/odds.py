"""Prior probabilities of the hypotheses on a gap."""

from dataclasses import dataclass, replace

from bayes_greybox.running.errors import InputError
from bayes_greybox.running.limits import Probability, beyond_limits


@dataclass(frozen=True)
class Odds:
    """Prior probabilities of the hypotheses; stated in every result.

    Each is above 0 and below 1, and concerns the whole system; of several equations, see `of_each`.

    Attributes:
        no_gap: Nothing is missing and every coefficient is right.
        recalibrate: Nothing is missing, but a coefficient of the simulation is off.
        unknown: Something is missing that the catalogue does not have.
        effects: One of the catalogue's effects is missing; shared equally between their names.
        another: Probability of a set of effects over that of one with an effect less.
        correction: Each coefficient of the simulation is off, beside an effect or f.
        remainder: A discrepancy remains beside an effect: a law of the states, something in time, or something that
            remembers, evenly.
        suspect: A channel of the measurement has a certain error (a delay, a gain, an offset).
        noise: The noise is of a certain other kind (correlated, dependent on the state, heavy-tailed).
        slow_sensor: Without effect: a lag of the only sensor is not weighed.

    Raises:
        InputError: A value that is no such probability; `another` and `unknown` that leave nothing to the rest.
    """

    no_gap: Probability = 0.3
    recalibrate: Probability = 0.2
    unknown: Probability = 0.1
    effects: Probability = 0.4
    another: Probability = 0.3
    correction: Probability = 0.1
    remainder: Probability = 0.2
    suspect: Probability = 0.02
    noise: Probability = 0.05
    slow_sensor: Probability = 0.5

    def __post_init__(self) -> None:
        for field, value, _ in beyond_limits(self):
            raise InputError(
                f"odds: {field} = {value!r} must be a probability above 0 and below 1; what is as good as excluded "
                "gets a small one."
            )
        total = self.no_gap + self.recalibrate + self.unknown + self.effects
        if not total < 1 + 1e-9:
            raise InputError(
                f"odds: no_gap, recalibrate, unknown and effects add up to {total:g}; they are "
                "parts of 1: raise one and lower another."
            )

    def of_each(self, equations: int) -> "Odds":
        """Return the odds of each of several equations: P(it has no gap) = P(no gap)^(1/n), others in proportion."""
        no_gap = self.no_gap ** (1 / equations)
        factor = (1 - no_gap) / (1 - self.no_gap)
        return replace(
            self, no_gap=no_gap, recalibrate=factor * self.recalibrate, unknown=factor * self.unknown,
            effects=factor * self.effects,
        )  # fmt: skip
