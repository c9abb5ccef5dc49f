"""Starts all simulators over one world, writes the theatre file, compares a finished run with the truth."""
