"""The plan and all that is checked before anything moves: CT, reach, paths, cart position, markers."""
