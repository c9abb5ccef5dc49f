"""Panels of the case page: HTML rendered from a view, and a few controls."""
