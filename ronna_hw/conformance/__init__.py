"""The suite that any device, on any endpoint, can be held against."""
