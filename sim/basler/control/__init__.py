"""Camera control channel (GVCP): registers, privilege, acknowledges and the GenICam XML."""
