"""Command-line interface of a case: options, displays, prompts, and the person at the terminal."""
