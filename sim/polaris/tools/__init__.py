"""Tools: definitions, port handles, wired tools and the unique-geometry rules."""
