"""What is held against an answer: residuals, motions, ends of ranges, rows that are linear near it only."""
