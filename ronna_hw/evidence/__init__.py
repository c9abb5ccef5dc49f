"""Integrity of a run folder: the journal's chain, the records' hashes, the seal, and the check."""
