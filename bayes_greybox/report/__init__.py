"""What a reader sees: figures."""
