"""Performance of the browser pages."""
