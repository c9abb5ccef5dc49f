"""The arm as the controller drives it: drives, and the motion of the true arm."""
