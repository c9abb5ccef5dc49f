"""`ronna-procedure new-theatre`: creates a theatre file for a laboratory's own devices."""
