"""Replay of a run from recorded answers, without devices, for comparison with its records."""
