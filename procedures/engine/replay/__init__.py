"""Replay of a run from recorded answers, without devices, and comparison with its records."""
