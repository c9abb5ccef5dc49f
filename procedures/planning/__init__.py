"""The plan and its checks before any motion: CT, reach, paths, cart position, markers."""
