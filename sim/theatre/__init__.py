"""Theatre: starts all simulators in one world, writes the theatre file and compares runs with the truth."""
