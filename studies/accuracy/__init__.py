"""Target error of each localization strategy, simulated on many random arms at a phantom."""
