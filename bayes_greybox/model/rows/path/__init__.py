"""The path that rows of samples are linear along: its segments, its steps, and its responses."""
