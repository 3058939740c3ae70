"""The next experiment: candidates, simulated under the surviving hypotheses, ranked by their information."""
