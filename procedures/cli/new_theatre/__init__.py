"""`ronna-procedure new-theatre`: creation of a theatre file for a laboratory's own devices."""
