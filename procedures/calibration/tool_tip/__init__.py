"""Calibration of the guide's tip: pivoted in a divot, and compared with the ball that the head sees there."""
