"""The calibrated arm: deviations from the nominal chain, and the error budget."""
