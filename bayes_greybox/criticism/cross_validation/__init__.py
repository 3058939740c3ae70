"""Cross-validation from one run: single rows, blocks, trajectories and the future."""
