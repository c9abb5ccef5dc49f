"""The error expected at a target during planning, and the strategy that minimizes it."""
