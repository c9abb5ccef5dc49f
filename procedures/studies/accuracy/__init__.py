"""Random arms at a phantom, many at once: how far from the target each strategy ends."""
