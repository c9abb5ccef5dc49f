"""The parts of the page, one module each: HTML generated from a view, and the few controls."""
