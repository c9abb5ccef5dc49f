"""The plan: what it says, its file, lock and seal, and its check against CT and arm."""
