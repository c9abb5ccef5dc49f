"""Injected faults of controller, arm and links."""
