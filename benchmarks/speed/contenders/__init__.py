"""Samplers of the same posterior: one file each, and the list of them."""
