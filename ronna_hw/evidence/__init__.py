"""What holds a run's folder to what it was: journal's chain, records' hashes, seal, and the one check."""
