"""Coded reasons against a verdict: reports branch on the code and print the text."""

from dataclasses import dataclass

ONE_LAW, ONE_LAW_AND_MORE = "one law", "one law and more"
"""Several effects of one quantity may be one law without a name; the same, and something is left besides."""

UNSEEN_SHAPE = "unseen shape"
"""Filtered rates do not show how an effect looks where it jumps or bends."""

CHECK, ROWS, END_OF_RANGE = "check", "rows", "end of range"
"""A check failed; the rows contradict any answer; a nonlinear parameter lies at an end of its range."""

NOT_COMPARED, WORSE_RUN, HELD_OUT = "not compared", "worse run", "held-out"
"""Held-out data could not be compared; a free run got worse; held-out samples are not explained."""

OF_SHAPE = (ONE_LAW, UNSEEN_SHAPE)
"""Codes that doubt the shape of what was found, and not that it is all."""


@dataclass(frozen=True)
class Reason:
    """One reason against a verdict: code, text, and the equation that it is about, "" of the whole study."""

    code: str
    text: str
    equation: str = ""
