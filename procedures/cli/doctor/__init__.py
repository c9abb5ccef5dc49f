"""`ronna-procedure doctor`: what this computer offers, and what the probes of the drivers find."""
