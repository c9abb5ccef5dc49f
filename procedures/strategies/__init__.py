"""Strategies for the arm's orientation at the fiducials and targets. Pure numerics."""
