"""User methods in the studies: looked up by name, checked, and run next to ours on the same data."""
