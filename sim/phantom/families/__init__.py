"""Scan families that differ in head, markers and surroundings."""
