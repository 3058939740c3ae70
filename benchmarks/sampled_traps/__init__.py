"""Samples that tempt a study to a wrong name: sensors and inputs that lie, machines that no catalogue has, controls."""
