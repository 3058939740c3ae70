"""The missing-effect study: where simulation and measurement disagree, what is missing, and the gap afterwards."""
