"""Calibration of the arm with spheres at rest: links, joints, gravity, backlash, head on the flange."""
