"""A CT as a single page for a browser."""
