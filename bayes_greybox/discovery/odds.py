"""Prior probabilities of the explanations of a gap."""

from dataclasses import dataclass

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.limits import Probability, beyond_limits


@dataclass(frozen=True)
class Odds:
    """Prior probabilities of the explanations; stated in every result.

    Each is above 0 and below 1.

    Attributes:
        no_gap: Nothing is missing and every coefficient is right.
        recalibrate: Nothing is missing, but a coefficient of the simulation is off.
        unknown: Something is missing that the catalogue does not have: f alone.
        effects: One of the catalogue's effects is missing; shared equally between their names.
        another: In later rounds, one more effect is missing; `unknown` as above, and the rest says that the effects
            already added are all.
        correction: Beside an effect or f, each coefficient of the simulation is off.
        remainder: Beside an effect, f remains.

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

    def __post_init__(self) -> None:
        for field, value, _ in beyond_limits(self):
            raise InputError(
                f"odds: {field} = {value!r} must be a probability above 0 and below 1; what is as good as excluded "
                "gets a small one."
            )
        if not self.another + self.unknown < 1:
            raise InputError(
                f"odds: another = {self.another:g} and unknown = {self.unknown:g} must leave something to the effects "
                "already added being all: their sum must be below 1."
            )
