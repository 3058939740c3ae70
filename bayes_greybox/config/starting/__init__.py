"""A first configuration for a table: the probable roles of its columns, and the file that states them."""
