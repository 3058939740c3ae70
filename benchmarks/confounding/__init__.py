"""Confounding of θ and f: what orthogonality costs and gives, over repeated data with a known answer.

`situations` makes the data in plain NumPy, `cells` fits all replicates of one situation under one kernel, `score` makes
the tables, and `run` does all of it and goes on where it was stopped.
"""
