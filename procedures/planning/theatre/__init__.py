"""Arm and surroundings as described by the theatre file."""
