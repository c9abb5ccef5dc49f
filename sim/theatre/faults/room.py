"""Faults of nobody's device: the room moves, screws loosen, hands do wrong, tools are not what they were.

Ways and forces are along the axes of the robot before it moved; of a tool, along those of its tip frame.
"""

from __future__ import annotations

from sim.theatre.faults.kinds import DeviceFaults, OneOf, fiducial_number

DEVICE = "room"
HEAD, CART, TRACKER = "head", "cart", "tracker"
ROOM = DeviceFaults(DEVICE)
lasting = ROOM.lasting

SHIFT = lasting(
    "shift",
    "shift NAME SIGNED SIGNED SIGNED mm",
    "The head, the robot's cart or the tracker is moved along the robot's x, y and z.",
    OneOf("to move the", (HEAD, CART, TRACKER)),
)
UNLOCKED = lasting(
    "unlocked",
    "unlocked cart SIGNED SIGNED SIGNED mm per min",
    "The brakes of the robot's cart are open: it rolls at that rate along the robot's x, y and z, and by as "
    "much as in a minute when somebody leans on it.",
)
LOOSEN = lasting(
    "loosen",
    "loosen marker INT SIGNED SIGNED SIGNED mm",
    "The screw of one sphere gives way: it stands that far beside its place, along the robot's x, y and z.",
    fiducial_number,
)
PUSH = lasting(
    "push",
    "push guide SIGNED SIGNED SIGNED N",
    "A hand presses or pulls on what hangs on the arm with that force, along the robot's x, y and z; "
    "the arm gives way as far as it is not stiff.",
)
WRONG_STOP = lasting("wrong_stop", "depth stop off by SIGNED mm", "The depth stop is set that much too deep.")
BENT_TIP = lasting(
    "bent_tip",
    "bent tip SIGNED SIGNED SIGNED mm",
    "The guide, or the mandrel in it, is bent: its end is that far from where it was calibrated.",
)
WRONG_MANDREL = lasting(
    "wrong_mandrel",
    "wrong mandrel SIGNED mm",
    "Another mandrel is in the guide, that much longer than the one of the calibration.",
)
BAD_SEAT = lasting(
    "bad_seat",
    "bad seat SIGNED mm SIGNED deg",
    "The changer is not closed: what hangs there stands off that far, tilted by that angle.",
)
WRONG_LOAD = lasting(
    "wrong_load",
    "wrong load SIGNED kg",
    "What hangs on the flange is that much heavier than the controller was told: the arm sags.",
)
ROOM_FAULTS = (
    SHIFT,
    UNLOCKED,
    LOOSEN,
    PUSH,
    WRONG_STOP,
    BENT_TIP,
    WRONG_MANDREL,
    BAD_SEAT,
    WRONG_LOAD,
)
