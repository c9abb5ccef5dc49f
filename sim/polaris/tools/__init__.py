"""Tools: definitions, port handles, wired tools, and whether two can be told apart."""
