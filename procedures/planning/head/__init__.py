"""The head of the CT: its shape, the tissue along a planned way, and what a way keeps clear of."""
