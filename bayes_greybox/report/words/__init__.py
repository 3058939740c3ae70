"""Words and numbers as tables, pages and the terminal write them."""
