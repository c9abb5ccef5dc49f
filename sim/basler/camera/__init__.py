"""A simulated camera: its features, its acquisition, and its view of the theatre."""
