"""Orientations of the arm at the fiducials and at a target. Pure numerics."""
