"""Localization strategies on random and on calibrated arms, next to table 4 of the thesis."""
