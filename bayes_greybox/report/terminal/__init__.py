"""Results as tables for a terminal; every number arrives computed."""
