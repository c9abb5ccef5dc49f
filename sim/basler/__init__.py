"""Two GigE Vision cameras that render the scene."""
