"""What a reader sees: figures, pages, tables for a terminal, records for a program."""
