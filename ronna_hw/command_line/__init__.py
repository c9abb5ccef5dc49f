"""The conventions that every command of the project shares."""
