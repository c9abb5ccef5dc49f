"""Fixation of the spheres of a named scene, as named by the commands."""

from __future__ import annotations

from enum import StrEnum


class Carrier(StrEnum):
    """Individual screws, or the x-shaped frame."""

    FREE = "free"
    XFRAME = "xframe"
