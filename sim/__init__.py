"""Simulators of all theatre devices: each speaks its device's wire protocol, over one shared physical scene."""
