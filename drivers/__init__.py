"""One folder per device. Each speaks the device's real protocol to an endpoint."""
