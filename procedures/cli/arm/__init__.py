"""`ronna-arm`: calibrate the arm, check that its calibration still holds."""
