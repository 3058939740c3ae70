"""Learned equations as text, LaTeX, MathML and JSON."""
