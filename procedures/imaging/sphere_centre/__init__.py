"""Sphere centre estimators: edge points along rays, and a blurred ball with or without streaks."""
