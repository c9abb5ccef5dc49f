"""Cost of the pages in a browser."""
