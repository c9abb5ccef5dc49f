"""Child processes of the measurements: peers to be measured against, started as scripts."""
