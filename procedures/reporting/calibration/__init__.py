"""What a calibration, a check or a single measurement found: written by its command, read by its report."""
