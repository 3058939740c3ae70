"""The exact trajectory posterior: NUTS on the paths themselves, from where linear rows lead."""
