"""Primary client interface: the controller's state ten times a second, its messages, and our script."""
