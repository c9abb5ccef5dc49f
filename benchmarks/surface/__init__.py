"""Registration on the skin beside other programs, on the same clouds."""
