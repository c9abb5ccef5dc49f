"""Calibration of the reference frame on the arm's mount: its pose on the flange."""
