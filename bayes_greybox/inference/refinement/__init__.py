"""The exact trajectory posterior: NUTS on the paths themselves, started from the posterior on linear rows."""
