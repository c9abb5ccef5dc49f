"""Steps of the procedures: one module for each clinical step, and one for the steps of each calibration."""
