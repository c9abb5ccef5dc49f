"""The arm as it is: its deviations from the nominal chain, and its error budget."""
