"""GVCP: the control channel to one camera, who it is, and who controls it."""
