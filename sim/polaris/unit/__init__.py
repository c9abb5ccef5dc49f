"""State of the tracker unit: model, mode, settings, alerts and faults."""
