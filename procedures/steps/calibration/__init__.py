"""Steps of calibrations."""
