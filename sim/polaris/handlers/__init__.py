"""Command handlers: functions of the unit and the argument, and their table."""
