"""The tracker against other clients."""
