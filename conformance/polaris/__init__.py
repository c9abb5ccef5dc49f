"""Protocol cases for NDI Polaris devices: the unit's replies (P) and its driver's commands (D)."""
