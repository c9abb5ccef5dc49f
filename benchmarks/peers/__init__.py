"""Peers for comparison, run as scripts in child processes."""
