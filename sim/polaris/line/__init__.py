"""Line between unit and host: transport, framing, command dispatch and line faults."""
