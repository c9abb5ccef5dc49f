"""`ronna-stereo`: commands and what they print."""
