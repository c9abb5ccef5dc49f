"""Simulators of all theatre devices, speaking the real wire protocols and sharing one scene."""
