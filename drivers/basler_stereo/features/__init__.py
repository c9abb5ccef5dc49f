"""GenICam: a camera's features, mapped to registers by its own description."""
