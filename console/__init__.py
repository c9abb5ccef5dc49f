"""The console in the browser: a case while it runs and afterwards, and the planner."""
