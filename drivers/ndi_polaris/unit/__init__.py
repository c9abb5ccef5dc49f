"""What the unit is and how it is set: identity, user parameters, volume, status."""
