"""`ronna-arm`: arm calibration and calibration checks."""
