"""Arm motion: limits, paths, plans, and cyclic set-points."""
