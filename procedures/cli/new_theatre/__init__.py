"""`ronna-procedure new-theatre`: begins the theatre file of a laboratory's own devices."""
