"""Journal of a run: each action is written before it begins and after it ends."""
