"""Reports: figures (`plots/`), HTML files (`pages/`), tables for a terminal, records, and result folders.

It reads results and samples nothing. `formatting` prints every number, `sentence` says a study's verdict.
"""
