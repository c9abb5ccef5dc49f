"""Replay: a run computed again from its recorded answers, without devices, and compared with its records."""
