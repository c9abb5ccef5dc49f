"""Calibrated arm model: deviations from the nominal chain, and the error budget."""
