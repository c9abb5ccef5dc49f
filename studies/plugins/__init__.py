"""User methods in the studies: found by name, checked, run beside ours on the same data."""
