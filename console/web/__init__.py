"""The page: its frame, its style, its socket, and its updates."""
