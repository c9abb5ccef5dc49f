"""Fault kinds outside the devices: moved objects, loosened screws, manual errors and altered tools.

Displacements and forces are along the axes of the robot before it moved; for a tool, along those of its tip
frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from sim.world.faults.fault import LARGEST, Arguments, FaultKinds, OneOf, fiducial_number, unless_known
from sim.world.scene.model import Scene

DEVICE = "room"
HEAD, CART, TRACKER, GUIDE, SEAT = "head", "cart", "tracker", "guide", "seat"
SLIPPING_HEAD = "slipping_head"
ASSISTANT_CART = "assistant_cart"
BODIES = (HEAD, SLIPPING_HEAD, CART, ASSISTANT_CART, TRACKER, GUIDE, SEAT)
ROOM = FaultKinds(DEVICE)
declare_lasting = ROOM.declare_lasting
LARGEST_MOVE_MM, LARGEST_TURN_DEG = LARGEST["mm"], 90.0


def tool_numbers(scene: Scene) -> tuple[int, ...]:
    """Return the numbers of the tools in the room, with 0 for no tool."""
    return (0, scene.mount.tool_number_stereo, scene.mount.tool_number_guide)


def _check_tool(arguments: Arguments, scene: Scene) -> Iterator[str]:
    yield from unless_known("tool", [str(number) for number in tool_numbers(scene)], arguments[0])


def cart_numbers(scene: Scene) -> tuple[int, ...]:
    """Return the numbers of the carts in the room, one per arm, the master's first."""
    return tuple(range(1, 1 + len(scene.arms)))


def _check_cart(arguments: Arguments, scene: Scene) -> Iterator[str]:
    number, *by_mm, turn_deg, _ = arguments
    yield from unless_known("cart", [str(known) for known in cart_numbers(scene)], number)
    if math.hypot(*map(float, by_mm)) > LARGEST_MOVE_MM or abs(float(turn_deg)) > LARGEST_TURN_DEG:
        got = f"{' '.join(by_mm)} mm {turn_deg} deg"
        yield f"expected at most {LARGEST_MOVE_MM:g} mm and {LARGEST_TURN_DEG:g} deg, got {got}"


def _check_present(arguments: Arguments, scene: Scene) -> Iterator[str]:
    if arguments[0] == ASSISTANT_CART and not scene.holders:
        yield f"expected a scene with two arms, got {scene.name}: there is no {ASSISTANT_CART}"


def _check_clamp(_arguments: Arguments, scene: Scene) -> Iterator[str]:
    if not scene.holders:
        yield f"expected a scene with two arms, got {scene.name}: there is no clamp"


def _check_time(arguments: Arguments, _scene: Scene) -> Iterator[str]:
    """Refuse an even motion without a time."""
    if not float(arguments[-1]) > 0.0:
        yield f"expected a time longer than 0 s, got {arguments[-1]} s: without one the body jumps"


SHIFT = declare_lasting(
    "shift",
    "shift NAME SIGNED SIGNED SIGNED mm",
    "A body is moved along the robot's x, y and z: the head with its clamp, the head within the clamp, so "
    f"that the patient's frame stays ({SLIPPING_HEAD}), the robot's cart, the assistant's cart "
    f"({ASSISTANT_CART}), the tracker, or by a hand the mounted guide; or the guide in its seat, along the "
    "axes of its calibrated tip.",
    OneOf("to move the", BODIES),
    _check_present,
)
SHIFT_OVER = declare_lasting(
    "shift_over",
    f"{SHIFT.phrase} over NUMBER s",
    "The same body creeps there evenly in that time, and stays.",
    *SHIFT.checks,
    _check_time,
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
EXTRA_SPHERE = declare_lasting(
    "extra_sphere",
    "extra sphere SIGNED SIGNED SIGNED mm",
    "One more sphere rests at that place in the room, along the robot's x, y and z. The tracker sees it, the "
    "cameras do not.",
)
PUSH = declare_lasting(
    "push",
    "push guide SIGNED SIGNED SIGNED N",
    "A hand pushes or pulls the mounted tool with that force, along the robot's x, y and z; "
    "the arm yields according to its stiffness.",
)
PUSH_OVER = declare_lasting(
    "push_over",
    f"{PUSH.phrase} over NUMBER s",
    "A hand leans on the mounted tool: the force grows evenly in that time, and stays.",
    _check_time,
)
TURN = declare_lasting(
    "turn",
    "turn NAME SIGNED SIGNED SIGNED deg",
    "The head turns about its centre, with its clamp or within it, a cart about the base of its arm, the "
    "tracker about its origin, the guide in its seat about its calibrated tip; or a hand turns the mounted "
    "guide about the tracked frame on the mount: the frame stays in its place, the guide's end does not, the "
    "encoders see nothing. The numbers are a rotation vector along the axes of a shift.",
    OneOf("to turn the", BODIES),
    _check_present,
)
TURN_OVER = declare_lasting(
    "turn_over",
    f"{TURN.phrase} over NUMBER s",
    "The same body turns there evenly in that time, and stays.",
    *TURN.checks,
    _check_time,
)
SLOWLY = {SHIFT_OVER: SHIFT, TURN_OVER: TURN, PUSH_OVER: PUSH}
"""Kinds that grow evenly over the time of their last argument, and what they come to."""
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
BENT_INSTRUMENT = declare_lasting(
    "bent_instrument",
    "bent instrument SIGNED SIGNED mm",
    "The instrument is bent beyond the guide: its tip is that far from its axis, along x and y of the "
    "guide's tip.",
)
WRONG_INSTRUMENT = declare_lasting(
    "wrong_instrument",
    "wrong instrument SIGNED mm",
    "Another instrument is inserted, longer by that much from its depth stop to its tip.",
)
LOOSE_INSTRUMENT = declare_lasting(
    "loose_instrument",
    "loose instrument SIGNED SIGNED SIGNED mm SIGNED deg",
    "The assistant's clamp is loose: once in the guide, the instrument is shifted by that much along the "
    "clamp's x, y and z, and tilted about its x axis. The bore holds it within its play.",
    _check_clamp,
)
OTHER_BONE = declare_lasting(
    "other_bone",
    "bone thicker SIGNED mm",
    "The skull is that much thicker than the CT shows, or thinner: its inside lies deeper, or less deep.",
)
DRILL_STALLS = declare_lasting(
    "drill_stalls",
    "drill stalls",
    "The drill in the assistant's holder does not turn, whoever switches it on.",
)
DRILL_ASIDE = declare_lasting(
    "drill_aside",
    "drill pushed aside SIGNED SIGNED N",
    "In the bone, the drill in the assistant's holder is pressed aside with that force, along x and y of the "
    "clamp. The sensor shows it with its friction; nothing bends.",
)
WRONG_LOAD = declare_lasting(
    "wrong_load",
    "wrong load SIGNED kg",
    "The load on the flange exceeds the load data in the controller by that much: the arm sags.",
)
MISSED_TASK = {WRONG_TOOL.name: "no tool was mounted", WRONG_STOP.name: "no depth stop was set"}
"""Faults that act only while the staff do a task, and why one had no effect."""
ROOM_FAULTS = tuple(ROOM.declared)
