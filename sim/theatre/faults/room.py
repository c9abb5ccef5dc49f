"""Faults of nobody's device: what stands in the room moves. Along the axes of the robot before it moved."""

from __future__ import annotations

from sim.theatre.faults.kinds import DeviceFaults, OneOf

DEVICE = "room"
HEAD, CART, TRACKER = "head", "cart", "tracker"

SHIFT = DeviceFaults(DEVICE).lasting(
    "shift",
    "shift NAME SIGNED SIGNED SIGNED mm",
    "The head, the robot's cart or the tracker is moved along the robot's x, y and z.",
    OneOf("to move the", (HEAD, CART, TRACKER)),
)
ROOM_FAULTS = (SHIFT,)
