"""Two GigE Vision cameras that render what they would see."""
