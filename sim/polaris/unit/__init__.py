"""The unit: its model, mode, settings, alerts and faults."""
