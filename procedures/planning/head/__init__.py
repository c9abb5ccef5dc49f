"""The head in the CT: its shape, the tissue along a planned trajectory, and structures to avoid."""
