"""Records that other people measured and published, studied as their owners would begin."""
