"""What all simulators share: the scene as it really is, its clock and faults, and what the staff do in it."""
