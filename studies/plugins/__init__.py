"""User methods for the studies: found by name, checked, and run next to ours on the same data."""
