"""Procedure steps: a module per clinical step, and modules for the steps of calibrations."""
