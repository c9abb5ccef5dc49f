"""The error to expect at a target while it is planned, and the strategy for which it is least."""
