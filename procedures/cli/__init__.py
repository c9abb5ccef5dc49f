"""The commands of the clinical side."""
