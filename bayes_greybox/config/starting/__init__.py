"""A first configuration for a table: what its columns probably are, and the file that says so."""
