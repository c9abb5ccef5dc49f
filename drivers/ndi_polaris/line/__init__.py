"""The line to the unit: transport, framing, commands and replies, baud rate."""
