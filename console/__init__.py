"""Browser console for running and recorded cases, and the planner."""
