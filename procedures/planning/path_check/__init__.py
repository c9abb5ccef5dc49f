"""Path check: the poses the arm visits in a procedure, joint angles for them, the motions between them."""
