"""Panels of the case's page: HTML generated from a view, and the few controls."""
