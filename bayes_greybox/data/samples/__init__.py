"""What samples say of their sensor and of the starts of their runs."""
