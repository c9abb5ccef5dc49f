"""Web page of the console: frame, style, socket, and updates."""
