"""Tracker unit state: model, mode, settings, alerts and faults."""
