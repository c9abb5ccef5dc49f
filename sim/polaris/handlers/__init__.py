"""Command handlers, each a function of the unit and the argument, and their command table."""
