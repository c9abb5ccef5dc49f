"""What stands before the tracker: true marker positions, the arm, and what faults do to them."""
