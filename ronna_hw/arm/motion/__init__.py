"""Motion of the arm: limits, paths, plans, and set-points cycle by cycle."""
