"""Accuracy of sphere localization in the CT, on phantom families and by the thesis' protocol."""
