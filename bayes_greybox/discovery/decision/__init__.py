"""From the table of hypotheses to a verdict with its reasons."""
