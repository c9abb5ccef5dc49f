"""What stands on the page, one module each: HTML out of a view, and the few parts that can be pressed."""
