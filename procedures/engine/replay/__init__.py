"""Replay: a run computed again from its recorded answers and compared with its records; no device is touched."""
