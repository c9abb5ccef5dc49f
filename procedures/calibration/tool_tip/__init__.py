"""Calibration of the guide's tip: pivoted over a divot, and against the ball that the head sees there."""
