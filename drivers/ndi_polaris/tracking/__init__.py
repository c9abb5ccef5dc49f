"""From TSTART to TSTOP: requests, replies and readings."""
