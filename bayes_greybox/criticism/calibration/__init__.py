"""Simulation-based calibration: is the posterior of data drawn from the model what it claims to be?"""
