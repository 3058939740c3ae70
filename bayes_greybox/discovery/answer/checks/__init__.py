"""Checks of an answer: residuals, ends of ranges, filtered rates, and rows that are linear near it only."""
