"""Journal of a run, written before each action begins and after it ends."""
