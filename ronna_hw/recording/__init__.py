"""Traffic on the links of a theatre, recorded for later analysis."""
