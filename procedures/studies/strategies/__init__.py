"""Localization strategies on random arms and on arms as calibrated, beside table 4 of the thesis."""
