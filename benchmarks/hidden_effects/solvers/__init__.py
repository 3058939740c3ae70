"""Who solves the cases: the study, the oracle that nobody can beat, and PySINDy."""
