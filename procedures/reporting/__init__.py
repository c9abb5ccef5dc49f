"""Report of a run, with its tables and pictures."""
