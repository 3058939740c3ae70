"""Prior probabilities of the explanations of a gap."""

from dataclasses import dataclass, replace

from bayes_greybox.running.errors import InputError
from bayes_greybox.running.limits import Probability, beyond_limits


@dataclass(frozen=True)
class Odds:
    """Prior probabilities of the explanations; stated in every result.

    Each is above 0 and below 1. They are those of the system: of several equations, see `of_each`.

    Attributes:
        no_gap: Nothing is missing and every coefficient is right.
        recalibrate: Nothing is missing, but a coefficient of the simulation is off.
        unknown: Something is missing that the catalogue does not have.
        effects: One of the catalogue's effects is missing; shared equally between their names.
        another: Of two sets of effects, the larger by one over the smaller.
        correction: Beside an effect or f, each coefficient of the simulation is off.
        remainder: Beside an effect, something else remains: a law of the states, something in time, or something that
            remembers, evenly.
        suspect: Each error of a channel of the measurement (a delay, a gain, an offset).
        noise: Each other kind of noise (it is correlated, it depends on the state, it has heavy tails).
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
        """Odds of one of several equations, so that all of them are right with the probability of the system.

        P(an equation has no gap) = P(no gap)^(1/n); what is left keeps its proportions.

        Args:
            equations: How many are studied.
        """
        no_gap = self.no_gap ** (1 / equations)
        rest = (1 - no_gap) / (1 - self.no_gap)
        return replace(
            self, no_gap=no_gap, recalibrate=rest * self.recalibrate, unknown=rest * self.unknown,
            effects=rest * self.effects,
        )  # fmt: skip
