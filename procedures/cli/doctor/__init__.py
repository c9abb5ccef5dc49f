"""`ronna-procedure doctor`: checks of this computer and results of the driver probes."""
