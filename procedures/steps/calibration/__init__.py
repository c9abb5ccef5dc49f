"""Calibration steps."""
