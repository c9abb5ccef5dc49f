"""Reference frame and tool tip calibration from simulated looks."""
