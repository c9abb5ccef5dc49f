"""Tools in the unit: port handles, loading, verification, and the definitions shipped with the driver."""
