"""The planner: a CT in slices, the spheres in it, and trajectories that are drawn, judged and saved."""
