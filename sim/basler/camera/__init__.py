"""Simulated camera: features, acquisition and view of the theatre."""
