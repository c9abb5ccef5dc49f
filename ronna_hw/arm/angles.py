"""Joint vectors in degrees, for display and for the wire."""

from __future__ import annotations

from math import degrees, radians

from ronna_hw.devices.readings import JointVector


def radians6(a: float, b: float, c: float, d: float, e: float, f: float) -> JointVector:
    """Six angles from degrees."""
    return (radians(a), radians(b), radians(c), radians(d), radians(e), radians(f))


def degrees6(joints_rad: JointVector) -> JointVector:
    """Six angles in degrees."""
    a, b, c, d, e, f = joints_rad
    return (degrees(a), degrees(b), degrees(c), degrees(d), degrees(e), degrees(f))
