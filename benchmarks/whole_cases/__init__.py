"""Whole simulated cases of every strategy on a block of seeds, as decision 31 has it."""
