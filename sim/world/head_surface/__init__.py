"""Heads with a face: shape, hair, regions, and how the skin moved between CT and theatre."""
