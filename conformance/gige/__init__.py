"""Cases for GigE Vision cameras on the wire (G)."""
