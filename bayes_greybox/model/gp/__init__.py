"""Kernels that are orthogonal to the dictionary, and their expansion in features."""
