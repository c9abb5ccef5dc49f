"""Text from outside, as it may be shown."""
