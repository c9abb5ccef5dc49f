"""`ronna-procedure calibrate`: what hangs on the mount of the arm, the reference frame and the guide."""
