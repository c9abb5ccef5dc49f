"""World shared by all simulators: true scene, clock, faults and staff."""
