"""Random arms at a phantom, many at once: the target error of each strategy."""
