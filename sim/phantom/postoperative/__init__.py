"""The postoperative CT, drawn from a run's truth: another pose, what was inserted, its streaks."""
