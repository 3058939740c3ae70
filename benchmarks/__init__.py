"""Benchmarks that are run from a checkout, `python -m benchmarks.NAME`, and are no part of the package."""
