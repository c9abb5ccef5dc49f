"""The plan and its pre-motion checks: CT, reach, paths, cart position, markers."""
