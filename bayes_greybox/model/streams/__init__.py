"""Designs of more rows than memory holds: two passes over their chunks, here or on other machines."""
