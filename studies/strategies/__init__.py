"""Localization strategies on random arms and on calibrated arms, next to table 4 of the thesis."""
