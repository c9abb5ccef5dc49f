"""Collisions of the arm: bodies, distances, whole paths before motion, and live monitoring."""
