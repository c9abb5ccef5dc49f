"""Lasting effects of faults, which outlive the program: things moved, bent or rotated."""

from __future__ import annotations

import math

from sim.world.faults.board import FaultBoard
from sim.world.faults.camera import TWIST
from sim.world.faults.language import at_moment
from sim.world.faults.room import CART, PUSH, ROOM_FAULTS
from sim.world.faults.room import DEVICE as ROOM
from sim.world.faults.tracker import DISPLACED_TOOLS
from sim.world.room_shift import rolled_mm
from sim.world.world import World

STANDING = (*(kind for kind in ROOM_FAULTS if kind is not PUSH), TWIST, *DISPLACED_TOOLS)


def standing_faults(world: World) -> str:
    """The script that reproduces them in a continued world, until the end they were given."""
    now_s = world.clock.now_s()
    lines = []
    for way in rolled_mm(FaultBoard(world, ROOM), now_s):
        lines.append(
            f"{at_moment(now_s)}: {ROOM} shift {CART} {' '.join(f'{value:.6f}' for value in way)} mm"
        )
    for device in sorted({kind.device for kind in STANDING}):
        for fault, onset_s in FaultBoard(world, device).acting_since():
            if fault.kind in STANDING:
                left_s = onset_s + fault.duration_s - now_s
                end = "" if math.isinf(left_s) else f" for {left_s:.6f} s"
                lines.append(f"{at_moment(now_s)}: {fault.phrase}{end}")
    return "\n".join(lines)
