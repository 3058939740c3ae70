"""What the answers are worth: each case alone, then the tables of a whole benchmark."""
