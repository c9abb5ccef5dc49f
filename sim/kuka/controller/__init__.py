"""The controller itself: modes, interlocks, messages, the cycle loop."""
