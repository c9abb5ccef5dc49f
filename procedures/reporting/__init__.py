"""The report of a run, its tables and pictures."""
