"""Sphere localization in CT, and the postoperative check."""
