"""Case engine: step declarations, step order, state machine and progress."""
