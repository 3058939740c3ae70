"""The decision: from probabilities of hypotheses to a verdict with its reasons."""
