"""Intervals that tables and figures of a study state."""

from statistics import NormalDist

INTERVAL = 0.9
"""Probability of an interval."""

INTERVAL_ENDS = ((1 - INTERVAL) / 2, (1 + INTERVAL) / 2)
"""Quantiles at its ends."""

INTERVAL_REACH = NormalDist().inv_cdf(INTERVAL_ENDS[1])
"""Standard deviations of a normal distribution from its mean to an end of the interval."""
