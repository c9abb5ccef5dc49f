"""Recording of link traffic in a theatre for later analysis."""
