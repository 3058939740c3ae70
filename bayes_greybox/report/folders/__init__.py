"""Folders that commands write: records, copies of configurations, whose they are, and reading them back."""
