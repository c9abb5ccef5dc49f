"""The planner: a CT in slices, its spheres, and trajectories that are drawn, judged and saved."""
