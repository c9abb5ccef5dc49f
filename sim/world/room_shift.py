"""Current displacement of objects in the room, and push on the arm, by faults of the device `room`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians

import numpy as np
from numpy.typing import NDArray

from sim.world.faults import Fault, FaultBoard
from sim.world.faults.room import CART, DEVICE, HEAD, LOOSEN, PUSH, SHIFT, TRACKER, TURN, UNLOCKED
from sim.world.rigid import Matrix, rotation_from_vector
from sim.world.world import World

Array = NDArray[np.float64]
Vector = tuple[float, float, float]
STILL: Vector = (0.0, 0.0, 0.0)
SECONDS_PER_MINUTE = 60.0


@dataclass(frozen=True)
class RoomShift:
    """Displacements of head and tracker relative to the robot base.

    `spheres_mm` by number: additional displacements of single spheres on the head.
    """

    head_mm: Vector = STILL
    tracker_mm: Vector = STILL
    guide_mm: Vector = STILL  # displacement of the mounted tool by a hand
    guide_rad: Vector = STILL  # turn of it about the tracked frame, a rotation vector
    spheres_mm: tuple[tuple[int, Vector], ...] = ()

    def of_spheres_mm(self, numbers: Sequence[int]) -> Array:
        """Displacements (n, 3) of the spheres with these numbers."""
        alone = dict(self.spheres_mm)
        return np.array([alone.get(one, STILL) for one in numbers], dtype=float).reshape(-1, 3) + self.head_mm


NOTHING_MOVED = RoomShift()


class ShiftedRoom:
    """Queries the fault board of the room; cheap if there are no faults."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._board = FaultBoard(world, DEVICE)
        self._stiffness_N_mm = world.scene.arm.stiffness_N_mm

    def now(self) -> RoomShift:
        """The current displacements."""
        if self._board.empty:
            return NOTHING_MOVED
        faults = self._board.active(SHIFT.name)
        cart = _total([_sum(faults, CART), *rolled_mm(self._board, self._world.clock.now_s())])
        x_N, y_N, z_N = _total(
            [[float(each) for each in one.arguments] for one in self._board.active(PUSH.name)]
        )
        turns = self._board.active(TURN.name)
        give = (x_N / self._stiffness_N_mm, y_N / self._stiffness_N_mm, z_N / self._stiffness_N_mm)
        loose = self._board.active(LOOSEN.name)
        return RoomShift(
            _apart(_sum(faults, HEAD), cart),
            _apart(_sum(faults, TRACKER), cart),
            give,
            _total([[radians(float(each)) for each in one.arguments] for one in turns]),
            tuple((int(number), _sum(loose, number)) for number in sorted({one.argument for one in loose})),
        )


def yielded(flange: Matrix, flange_from_marker: Matrix, room: RoomShift) -> Matrix:
    """ROBOT <- FLANGE (4, 4) of an arm that yields to the hand on its tool."""
    if not any((*room.guide_mm, *room.guide_rad)):
        return flange
    about_mm = (flange @ flange_from_marker)[:3, 3]
    turn = rotation_from_vector(room.guide_rad)
    held = flange.copy()
    held[:3, :3] = turn @ flange[:3, :3]
    held[:3, 3] = turn @ (flange[:3, 3] - about_mm) + about_mm + room.guide_mm
    return held


def rolled_mm(board: FaultBoard, now_s: float) -> tuple[Vector, ...]:
    """How far the cart has rolled since its brakes were released, per fault that makes it roll."""
    return tuple(
        _total([[float(rate) * (now_s - onset_s) / SECONDS_PER_MINUTE for rate in fault.arguments]])
        for fault, onset_s in board.acting_since()
        if fault.kind is UNLOCKED
    )


def _sum(faults: tuple[Fault, ...], what: str) -> Vector:
    return _total(
        [[float(number) for number in fault.arguments[1:]] for fault in faults if fault.argument == what]
    )


def _total(ways: Sequence[Sequence[float]]) -> Vector:
    x, y, z = (sum(column) for column in zip(*ways, strict=True)) if ways else STILL
    return (x, y, z)


def _apart(one: Vector, other: Vector) -> Vector:
    x, y, z = (a - b for a, b in zip(one, other, strict=True))
    return (x, y, z)
