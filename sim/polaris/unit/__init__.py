"""The unit: model, mode, settings, alerts and faults."""
