"""The gap before and after: its table, and free runs."""
