"""Stereo head: sphere centres, images, calibration and frame rate."""
