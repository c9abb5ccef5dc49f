"""One camera: its settings and features, its acquisition, and its view of the theatre."""
