"""The line to the host: transport, framing, command dispatch and line faults."""
