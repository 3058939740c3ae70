"""Hidden effects: known physics left out of a simulation, to see whether the study finds what was left out.

`cases` says what is hidden where, `host_systems` and `hidden` are systems and effects in plain NumPy, `generate` makes
the data, `solve` runs the study on them, `oracle` and `peers` are what it is compared with, `score` makes the tables,
and `run` does all of it and goes on where it was stopped.
"""
