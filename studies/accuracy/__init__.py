"""Simulated target errors of each localization strategy, over many random arms at a phantom."""
