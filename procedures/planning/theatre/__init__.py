"""Arm and surroundings, as the theatre file describes them."""
