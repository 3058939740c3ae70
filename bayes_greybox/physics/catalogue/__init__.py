"""The catalogue of effects that a simulation may be missing: the entries, their files, and what they act between."""
