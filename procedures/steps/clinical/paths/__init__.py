"""Paths of the arm in a case: what surrounds it, the search for them, their previews in records."""
