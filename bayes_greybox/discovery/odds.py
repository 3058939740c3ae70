"""Prior probabilities of the explanations of a gap."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Odds:
    """Prior probabilities of the explanations; stated in every result.

    Attributes:
        no_gap: Nothing is missing and every coefficient is right.
        recalibrate: Nothing is missing, but a coefficient of the simulation is off.
        unknown: Something is missing that the catalogue does not have: f alone.
        effects: One of the catalogue's effects is missing; shared equally between their names.
        another: In later rounds, one more effect is missing; `unknown` as above, and the rest says that the effects
            already added are all.
        correction: Beside an effect or f, each coefficient of the simulation is off.
        remainder: Beside an effect, f remains.
    """

    no_gap: float = 0.3
    recalibrate: float = 0.2
    unknown: float = 0.1
    effects: float = 0.4
    another: float = 0.3
    correction: float = 0.1
    remainder: float = 0.2
