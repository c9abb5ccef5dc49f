"""Cases for devices on the NDI Polaris protocol: the unit's replies (P) and its driver's commands (D)."""
