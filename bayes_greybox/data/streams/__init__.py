"""Rows of which there are too many for memory: read a piece at a time, here or elsewhere."""
