"""The scene in front of the tracker: true marker positions, occlusion, and faults that act on them."""
