"""Kinds of files that a table is read from: each a reader of its own."""
