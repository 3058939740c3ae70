"""The gap before and after: its table, free runs, and what both hold against an answer."""
