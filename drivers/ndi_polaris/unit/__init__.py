"""The unit: identity, user parameters, volume, illuminators, system status."""
