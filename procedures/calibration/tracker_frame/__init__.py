"""Calibration of the reference frame on the arm's mount: where the tracker's frame is on the flange."""
