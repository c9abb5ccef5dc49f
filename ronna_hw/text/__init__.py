"""Text from outside, made safe to display."""
