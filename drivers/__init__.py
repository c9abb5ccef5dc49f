"""Device drivers, one package each. Every driver speaks the device's real protocol to an endpoint."""
