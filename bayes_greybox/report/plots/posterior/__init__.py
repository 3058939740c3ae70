"""Figures of posteriors, their checks, and comparisons of them."""
