"""Tools in the unit: handles, loading, checks, and the definitions that come with the driver."""
