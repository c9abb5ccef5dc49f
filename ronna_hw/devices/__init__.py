"""Typed device interfaces, their lifecycle, and the readings they give."""
