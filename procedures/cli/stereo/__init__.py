"""`ronna-stereo`: its options, what it writes and what it prints."""
