"""Noise, ranges and starts that samples show of their sensors and runs."""
