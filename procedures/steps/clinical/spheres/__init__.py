"""Spheres as several steps know them: roughly matched, and left out."""
