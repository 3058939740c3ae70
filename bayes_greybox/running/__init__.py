"""How work runs: programs that are compiled and kept, and what a user sees of it meanwhile."""
