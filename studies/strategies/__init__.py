"""Localization strategies on random and calibrated arms, compared with table 4 of the thesis."""
