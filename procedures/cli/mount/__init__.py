"""`ronna-procedure calibrate`: the mounted tools: the reference frame and the guide."""
