"""Moves of the arms' carts by the theatre's staff, one cart per arm, numbered as the arms from 1.

A move is a line of the theatre's script (`room move cart`), so that it survives the theatre and can be
scheduled like a fault. The cart rolls straight and turns on its wheels at an even pace. It carries its arm,
the master's also calibration stand and gauge; head and tracker stay in the room.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from sim.errors import BAD_CART_MOVE
from sim.world.faults.fault import Fault, join_choices
from sim.world.faults.room import DEVICE, LARGEST_MOVE_MM, LARGEST_TURN_DEG, MOVE, cart_numbers
from sim.world.options import ArmRole
from sim.world.rigid import Matrix, matrix_from, rotation_from_vector
from sim.world.scene.model import Scene

# Of a heavy cart that one person pushes and another steers: a slow walk. An assumption, not a measurement.
PACE_MM_S, PACE_DEG_S = 500.0, 30.0
CART_OF = {ArmRole.MASTER: "1", ArmRole.ASSISTANT: "2"}  # as in a script
SCRIPT_STEP_S = 0.001  # times are written with six decimals
DONE_S = "0"  # time that a finished move still takes


@dataclass(frozen=True)
class CartDisplacement:
    """Move of a cart along the robot's present axes, and turn about its z axis through its base."""

    number: int
    by_mm: tuple[float, float, float]
    turn_deg: float

    @property
    def duration_s(self) -> float:
        """Theatre time that the move takes, in whole steps of a script's time."""
        takes_s = max(math.hypot(*self.by_mm) / PACE_MM_S, abs(self.turn_deg) / PACE_DEG_S)
        return math.ceil(takes_s / SCRIPT_STEP_S) * SCRIPT_STEP_S

    def check_size(self) -> None:
        """Raise SIM-016 for no move, for one that is not finite, and for one beyond the room."""
        shift_mm = math.hypot(*self.by_mm)
        given = f"by {' '.join(f'{value:g}' for value in self.by_mm)} mm, turned by {self.turn_deg:g} deg"
        if not math.isfinite(shift_mm) or not math.isfinite(self.turn_deg):
            raise BAD_CART_MOVE("the move is not finite", expected="finite numbers", got=given)
        if shift_mm > LARGEST_MOVE_MM or abs(self.turn_deg) > LARGEST_TURN_DEG:
            limit = f"{LARGEST_MOVE_MM:g} mm and {LARGEST_TURN_DEG:g} deg"
            raise BAD_CART_MOVE("the cart would leave the room", limit=limit, got=given)
        if shift_mm == self.turn_deg == 0.0:
            raise BAD_CART_MOVE("the cart would stay where it is", got=given)

    def check(self, scene: Scene) -> None:
        """Raise SIM-016 for a cart that is not there, and as `check_size`."""
        if self.number not in (known := cart_numbers(scene)):
            expected = f"cart {join_choices([str(number) for number in known])}"
            raise BAD_CART_MOVE("there is no such cart", expected=expected, got=f"cart {self.number}")
        self.check_size()

    @property
    def line(self) -> str:
        """The move as a line of a script, without its beginning."""
        x, y, z = (f"{value:.6f}" for value in self.by_mm)
        turn, time = f"{self.turn_deg:.6f}", f"{self.duration_s:.6f}"
        return f"{DEVICE} move {MOVE.phrase.split()[1]} {self.number} {x} {y} {z} mm {turn} deg in {time} s"


def cart_pose(moves: Iterable[tuple[Fault, float]], now_s: float, role: ArmRole) -> Matrix:
    """Return the pose (4, 4) of an arm's base in that base before all moves.

    `moves` are those of all carts, with their onsets. Each is along the axes at its onset; of moves with the
    same one, the earlier line goes first.
    """
    pose = np.eye(4)
    own = [one for one in moves if one[0].argument == CART_OF[role]]
    for move, onset_s in sorted(own, key=itemgetter(1)):
        *by_mm, turn_deg, duration_s = (float(argument) for argument in move.arguments[1:])
        share = min(1.0, (now_s - onset_s) / duration_s) if duration_s > 0.0 else 1.0
        turn = rotation_from_vector((0.0, 0.0, math.radians(share * turn_deg)))
        pose = pose @ matrix_from(share * np.array(by_mm), turn)
    return pose


def finished(move: Fault) -> Fault:
    """Return the move as completed at its onset, as a saved world states it."""
    return replace(move, arguments=(*move.arguments[:-1], DONE_S))
