"""How the arm is oriented while it localizes: OCS and, later, its peers."""
