"""Command-line conventions shared by all commands of the project."""
