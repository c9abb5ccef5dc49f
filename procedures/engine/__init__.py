"""Where a case is: its steps, their order, and what comes next."""
