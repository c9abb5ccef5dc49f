"""Browser console: a case while it runs and afterwards, and the planner."""
