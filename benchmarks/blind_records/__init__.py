"""Records that were made to fool a study by someone who had not seen its code."""
