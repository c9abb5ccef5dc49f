"""User methods in the studies: found by name, checked, run next to ours on the same data."""
