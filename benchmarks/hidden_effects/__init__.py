"""Hidden effects: known physics left out of a simulation, to see whether the study finds what was left out."""
