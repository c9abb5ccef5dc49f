"""The page: its frame, its style, its socket, and how it is kept fresh."""
