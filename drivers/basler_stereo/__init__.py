"""Two GigE Vision cameras as one stereo pair."""
