"""Commands for existing runs."""
