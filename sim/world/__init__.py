"""What all simulators share: the scene as it really is, its clock and faults, and what hands do in it."""
