"""The scanned head: layers, anatomy, markers and surrounding objects."""
