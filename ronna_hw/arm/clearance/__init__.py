"""Collision avoidance for the arm: bodies, distances, path checks before motion, live monitoring."""
