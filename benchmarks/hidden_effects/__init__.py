"""Hidden effects: known physics left out of a simulation, to see whether the study finds what was left out.

`cases` says what is hidden where, `systems` has hosts and effects in plain NumPy, `generate` makes the data and
`assumptions` those that break one, `solvers` are the study and what it is compared with, `scoring` makes the tables,
and `run` does all of it and goes on where it was stopped.
"""
