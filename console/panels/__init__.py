"""Panels of the case page: HTML generated from a view, and a few controls."""
