"""A low-cost theatre: a UR5 guided by a Polaris Vicra to targets registered from a CT (PAPER 2)."""
