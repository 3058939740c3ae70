"""What results look like: figures, pages, terminal tables, folders and records, made from results and nothing else."""

It reads results and samples nothing. `formatting` prints every number, `sentence` says a study's verdict.
"""
