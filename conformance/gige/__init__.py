"""Protocol cases for GigE Vision cameras (G)."""
