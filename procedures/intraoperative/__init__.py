"""Scan during the operation: its place in the planning CT by bone and spheres, and that place's error."""
