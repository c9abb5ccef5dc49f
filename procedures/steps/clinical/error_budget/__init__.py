"""The error budget that a registration is judged by."""
