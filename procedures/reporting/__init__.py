"""Run report with its tables and figures."""
