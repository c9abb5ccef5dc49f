"""`ronna-stereo`: commands and output."""
