"""What the calibrations of the stereo head and of the arm have in common on the command line."""
