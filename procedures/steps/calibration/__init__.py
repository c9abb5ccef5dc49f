"""The steps of calibrations, one module each."""
