"""The conventions shared by all commands of the project."""
