"""Commands about runs that there are: take one up again, verify, draw, list and show it."""
