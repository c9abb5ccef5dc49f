"""Planner: CT slices with detected spheres, and trajectories to be drawn, assessed and saved."""
