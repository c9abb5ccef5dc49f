"""The head to scan: its layers, anatomy and markers, and the objects around it."""
