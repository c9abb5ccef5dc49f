"""Marker positions on the head: where they help most, whether they are distinguishable, the template."""
