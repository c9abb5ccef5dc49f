"""Fault kinds outside the devices: moved objects, loosened screws, manual errors and altered tools.

Displacements and forces are along the axes of the robot before it moved; for a tool, along those of its tip
frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from sim.world.faults.fault import Arguments, DeviceFaults, OneOf, fiducial_number, unless_known
from sim.world.scene.model import Scene

DEVICE = "room"
HEAD, CART, TRACKER, GUIDE = "head", "cart", "tracker", "guide"
ROOM = DeviceFaults(DEVICE)
declare_lasting = ROOM.declare_lasting
# Twice the reach of the arm: from there, no head that was within reach is still within it.
LARGEST_MOVE_MM, LARGEST_TURN_DEG = 2000.0, 90.0


def tool_numbers(scene: Scene) -> tuple[int, ...]:
    """Return the numbers of the tools in the room, with 0 for no tool."""
    return (0, scene.mount.tool_number_stereo, scene.mount.tool_number_guide)


def _check_tool(arguments: Arguments, scene: Scene) -> Iterator[str]:
    yield from unless_known("tool", [str(number) for number in tool_numbers(scene)], arguments[0])


def cart_numbers(scene: Scene) -> tuple[int, ...]:
    """Return the numbers of the carts in the room, one per arm, the master's first."""
    return (1,) if scene.assistant is None else (1, 2)


def _check_cart(arguments: Arguments, scene: Scene) -> Iterator[str]:
    number, *by_mm, turn_deg, _ = arguments
    yield from unless_known("cart", [str(known) for known in cart_numbers(scene)], number)
    if math.hypot(*map(float, by_mm)) > LARGEST_MOVE_MM or abs(float(turn_deg)) > LARGEST_TURN_DEG:
        got = f"{' '.join(by_mm)} mm {turn_deg} deg"
        yield f"expected at most {LARGEST_MOVE_MM:g} mm and {LARGEST_TURN_DEG:g} deg, got {got}"


SHIFT = declare_lasting(
    "shift",
    "shift NAME SIGNED SIGNED SIGNED mm",
    "The head, the robot's cart or the tracker is moved along the robot's x, y and z.",
    OneOf("to move the", (HEAD, CART, TRACKER)),
)
MOVE = declare_lasting(
    "move",
    "move cart INT SIGNED SIGNED SIGNED mm SIGNED deg in NUMBER s",
    "The cart of an arm is wheeled along the robot's x, y and z as they are by then, and turned about its z "
    "axis, within that time. It stays there when all faults are cleared, which cancels a move that has not "
    "begun. `ronna-sim move cart` does the same at once.",
    _check_cart,
)
UNLOCKED = declare_lasting(
    "unlocked",
    "unlocked cart SIGNED SIGNED SIGNED mm per min",
    "The brakes of the robot's cart are open: it rolls at that rate along the robot's x, y and z, and by "
    "one minute's worth when someone leans on it.",
)
LOOSEN = declare_lasting(
    "loosen",
    "loosen marker INT SIGNED SIGNED SIGNED mm",
    "The screw of one sphere gives way: the sphere is displaced by that much, along the robot's x, y and z.",
    fiducial_number,
)
PUSH = declare_lasting(
    "push",
    "push guide SIGNED SIGNED SIGNED N",
    "A hand pushes or pulls the mounted tool with that force, along the robot's x, y and z; "
    "the arm yields according to its stiffness.",
)
TURN = declare_lasting(
    "turn",
    "turn NAME SIGNED SIGNED SIGNED deg",
    "The head turns about its centre, the robot's cart about the robot's base, or a hand turns the mounted "
    "guide about the tracked frame on the mount: the frame stays in its place, the guide's end does not, the "
    "encoders see nothing. The numbers are a rotation vector along the robot's x, y and z.",
    OneOf("to turn the", (HEAD, CART, GUIDE)),
)
WRONG_STOP = declare_lasting(
    "wrong_stop", "depth stop off by SIGNED mm", "The depth stop is set that much too deep, at each setting."
)
BENT_TIP = declare_lasting(
    "bent_tip",
    "bent tip SIGNED SIGNED SIGNED mm",
    "The guide, or the mandrel in it, is bent: its end is that far from its calibrated position.",
)
WRONG_TOOL = declare_lasting(
    "wrong_tool",
    "wrong tool INT",
    "At each tool change the tool with this number is mounted, whichever was asked for; 0: none.",
    _check_tool,
)
WRONG_MANDREL = declare_lasting(
    "wrong_mandrel",
    "wrong mandrel SIGNED mm",
    "Another mandrel is in the guide, longer by that much than the one used for calibration.",
)
BAD_SEAT = declare_lasting(
    "bad_seat",
    "bad seat SIGNED mm SIGNED deg",
    "The changer is not closed: the mounted tool is offset by that distance and tilted by that angle.",
)
WRONG_LOAD = declare_lasting(
    "wrong_load",
    "wrong load SIGNED kg",
    "The load on the flange exceeds the load data in the controller by that much: the arm sags.",
)
MISSED_TASK = {WRONG_TOOL.name: "no tool was mounted", WRONG_STOP.name: "no depth stop was set"}
"""Faults that act only while the staff do a task, and why one had no effect."""
ROOM_FAULTS = (
    SHIFT,
    MOVE,
    UNLOCKED,
    LOOSEN,
    PUSH,
    TURN,
    WRONG_STOP,
    BENT_TIP,
    WRONG_TOOL,
    WRONG_MANDREL,
    BAD_SEAT,
    WRONG_LOAD,
)
