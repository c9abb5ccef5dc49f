"""`ronna-procedure doctor`: checks of this computer, and driver probe results."""
