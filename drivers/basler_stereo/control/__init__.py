"""GVCP: the control channel to one camera, its identity, and control privilege."""
