"""A case at the command line: options, displays, prompts, and the person at the terminal."""
