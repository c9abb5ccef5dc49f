"""Steps of the procedures: one module per clinical step, and one per calibration for its steps."""
