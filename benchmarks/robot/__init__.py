"""The robot link and its set-points."""
