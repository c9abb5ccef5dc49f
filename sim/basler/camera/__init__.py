"""One camera: its settings, the limits of its features, and the timing of its exposures."""
