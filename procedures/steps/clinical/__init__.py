"""Clinical steps, one module each."""
