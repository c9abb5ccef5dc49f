"""Simulated looks for the calibrations of reference frame and tool tip."""
