"""A run computed again from what its devices answered, compared with its records; no device is touched."""
