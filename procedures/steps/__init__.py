"""Steps of the procedures: one module for each clinical step, one for the steps of each calibration."""
