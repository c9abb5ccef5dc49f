"""Device drivers, one package each; every driver speaks the device's real protocol."""
