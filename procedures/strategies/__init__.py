"""How the arm is oriented while it localizes the fiducials and when it is at a target. Pure numerics."""
