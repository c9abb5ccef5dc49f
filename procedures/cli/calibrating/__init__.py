"""Calibrations at the command line."""
