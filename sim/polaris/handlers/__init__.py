"""Command handlers, each a function of the unit and the argument, and the table that lists them."""
