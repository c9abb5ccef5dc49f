"""The plan: its content, file, lock and seal, and its check against CT and arm."""
