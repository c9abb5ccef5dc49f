"""The journal of a run: written before anything happens, and again when it has happened."""
