"""Estimators of a sphere's centre: edge points along rays, and a blurred ball with or without streaks."""
