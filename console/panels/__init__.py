"""The parts of the page, one module each: HTML made from a view, and the few controls."""
