"""Integration in time: adaptive and fixed steps, many runs at once, sensitivities and smoothed paths."""
