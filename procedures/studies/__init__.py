"""Campaigns against truth; the one place that may import the simulators."""
