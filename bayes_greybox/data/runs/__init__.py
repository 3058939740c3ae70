"""Runs as they lie in memory, and as they are cut, thinned and put on other times."""
