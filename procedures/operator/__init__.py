"""Operator decisions, tasks of the room's staff, and checkpoints at which a case waits."""
