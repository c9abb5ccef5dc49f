"""Sphere localization in CT, and the check after the operation."""
