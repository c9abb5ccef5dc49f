"""Robot link and its set-points."""
