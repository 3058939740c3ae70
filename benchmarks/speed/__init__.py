"""How fast posteriors are drawn, beside others that draw the same; and how far that is from what the machine can do."""
