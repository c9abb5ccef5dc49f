"""Calibration commands."""
