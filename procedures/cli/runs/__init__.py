"""Commands on existing runs: resume, verify, draw, list and show them."""
