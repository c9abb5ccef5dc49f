"""What the unit does for each command: functions of the unit and the argument, and their table."""
