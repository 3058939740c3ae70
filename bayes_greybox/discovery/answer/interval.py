"""Intervals that tables and figures of a study state."""

from statistics import NormalDist

TAIL = 0.05
"""Probability on either side of an interval: 90 % are within."""

REACH = NormalDist().inv_cdf(1 - TAIL)
"""Standard deviations of a normal distribution from its mean to an end of the interval."""
