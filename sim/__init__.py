"""The simulated theatre: devices that speak real bytes over one physical scene."""
