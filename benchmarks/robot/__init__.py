"""Robot link and set-point generation."""
