"""Readers of kinds of files."""
