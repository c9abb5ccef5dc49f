"""Calibrations of reference frame and tool tip, from simulated looks."""
