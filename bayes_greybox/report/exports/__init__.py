"""Learned models as programs of other languages: Python, C and Modelica."""
