"""The worth of the answers: each case alone, then the tables of a whole benchmark."""
