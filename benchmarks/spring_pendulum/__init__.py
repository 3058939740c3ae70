"""The public demonstration of neural FMUs: a pendulum on a spring, whose simulation is an FMU without friction."""
