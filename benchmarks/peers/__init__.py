"""Peers for comparison, which run as scripts in child processes."""
