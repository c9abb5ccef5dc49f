"""Cost of the browser pages."""
