"""NDI Polaris over a serial line or TCP."""
