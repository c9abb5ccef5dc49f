"""Accuracy of sphere localization in CT, on phantom families and by the thesis' protocol."""
