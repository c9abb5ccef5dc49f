"""GenICam camera features, mapped to registers by the camera's own description."""
