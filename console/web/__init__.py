"""Web page of the console: layout, style, socket, and updates."""
