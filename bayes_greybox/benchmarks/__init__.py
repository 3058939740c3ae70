"""Benchmarks that users can run and extend: data with a known answer, and what the package makes of them."""
