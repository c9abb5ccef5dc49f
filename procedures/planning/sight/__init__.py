"""What stereo head and tracker see from the planned poses."""
