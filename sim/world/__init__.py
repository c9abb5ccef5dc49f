"""World shared by all simulators: the true scene, its clock, its faults and its staff."""
