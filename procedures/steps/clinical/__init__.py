"""The steps of a case, one module each."""
