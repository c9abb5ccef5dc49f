"""Integrity of a run's folder: the journal's chain, the records' hashes, the seal, and the check."""
