"""What the pages in a browser cost."""
