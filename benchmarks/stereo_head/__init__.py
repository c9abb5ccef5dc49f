"""Stereo head: sphere centres, images, calibration, frame rate."""
