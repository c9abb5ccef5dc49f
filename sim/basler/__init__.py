"""Simulated stereo head: two GigE Vision cameras that render the scene."""
