"""Calibration of the arm with stationary spheres: links, joints, gravity, backlash, head on the flange."""
