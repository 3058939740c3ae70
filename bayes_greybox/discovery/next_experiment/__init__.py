"""The next experiment: candidates, simulated under the surviving hypotheses, ranked by what they tell of these."""
