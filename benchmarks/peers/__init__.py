"""Child processes of the measurements: peers for comparison, started as scripts."""
