"""What the arm could meet: bodies, distances, whole paths before motion, and the live watch."""
