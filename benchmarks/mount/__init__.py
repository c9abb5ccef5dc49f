"""Looks for the calibrations of reference frame and tool tip."""
