"""The stereo head: sphere centres, pictures, calibration, rate."""
