"""Simulators of all theatre devices, which speak the real wire protocols over one shared scene."""
