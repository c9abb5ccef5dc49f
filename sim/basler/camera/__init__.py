"""One camera: its settings, what its features allow, and when it exposes."""
