"""A case from the command line: its theatre, its engine, who answers, and what is shown."""
