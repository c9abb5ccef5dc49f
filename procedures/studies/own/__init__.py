"""A reader's own methods in the studies: found by name, checked, run beside ours on the same data."""
