"""Operator decisions, tasks for the room staff, and checkpoints at which a case waits."""
