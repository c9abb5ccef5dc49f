"""Planner: CT slices, the spheres in them, and trajectories that are drawn, judged and saved."""
