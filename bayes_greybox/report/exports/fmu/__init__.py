"""Learned models as FMUs: FMI 2.0 for Model Exchange and for Co-Simulation."""
