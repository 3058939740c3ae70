"""Figures of the gap between simulation and measurement, and of what could close it."""
