"""Families of scans that differ in head, markers and surroundings."""
