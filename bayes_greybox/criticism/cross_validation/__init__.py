"""How well a model predicts what it has not seen: leave-one-out, blocks, trajectories and the future, from one run."""
