"""Command-line interface of a case: options, displays, prompts and the terminal operator."""
