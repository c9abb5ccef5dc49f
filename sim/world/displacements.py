"""True positions in the room after fault displacements and refitting of spheres after the CT.

Bases and spheres are removed after the CT and refitted on their screws, each slightly off its position in the
CT. One may also be on a loosened screw or a bent base, on the base of another, or missing. Cameras and
tracker see the spheres of the theatre, the scanner those of the CT.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.world.carts import cart_pose
from sim.world.faults import Fault, FaultBoard
from sim.world.faults.room import (
    ASSISTANT_CART,
    CART,
    DEVICE,
    EXTRA_SPHERE,
    GUIDE,
    HEAD,
    LOOSEN,
    MOVE,
    PUSH,
    SEAT,
    SHIFT,
    SLIPPING_HEAD,
    TRACKER,
    TURN,
    UNLOCKED,
)
from sim.world.noise import noise
from sim.world.options import ArmRole
from sim.world.rigid import (
    Array,
    Matrix,
    Point,
    apply,
    as_point,
    inverse,
    matrix_from,
    matrix_of,
    rotation_from_vector,
    vector_from_rotation,
)
from sim.world.scene.model import Fiducial, Scene
from sim.world.slow_faults import come_to
from sim.world.world import World

STILL: Point = (0.0, 0.0, 0.0)
IDENTITY = np.eye(4)
SECONDS_PER_MINUTE = 60.0
SEATING = "seating"  # noise key; each screw draws independently of the others


@dataclass(frozen=True)
class RoomShift:
    """Displacement relative to the robot base: a rotation about its origin, then a translation.

    `spheres_mm` are additional displacements of single spheres, by number; `extra_spheres_mm` are the places
    of further ones.
    """

    head_mm: Point = STILL
    tracker_mm: Point = STILL
    head_rad: Point = STILL
    tracker_rad: Point = STILL
    guide_mm: Point = STILL  # of the mounted tool, by a hand
    push_N: Point = STILL  # of that hand
    guide_rad: Point = STILL  # about the tracked frame
    assistant_mm: Point = STILL  # of the assistant's base, as of the head
    assistant_rad: Point = STILL
    seat_mm: Point = STILL  # of the guide in its seat, along the axes of its calibrated tip
    seat_rad: Point = STILL  # about that tip
    slip_mm: Point = STILL  # part of the head's displacement that its clamp does not share
    slip_rad: Point = STILL
    spheres_mm: tuple[tuple[int, Point], ...] = ()
    extra_spheres_mm: tuple[Point, ...] = ()  # at rest in the room, on no head

    def displace_spheres_mm(self, places_mm: Array, numbers: Sequence[int]) -> Array:
        """Displace spheres (n, 3) in the robot frame, identified by their numbers in the scene."""
        alone = dict(self.spheres_mm)
        loose = np.array([alone.get(one, STILL) for one in numbers], dtype=float).reshape(-1, 3)
        places: Array = apply(rigid_move(self.head_rad, self.head_mm), places_mm) + loose
        return places

    def move_of_clamp(self) -> Matrix:
        """Return the displacement (4, 4) of the head's clamp, in which the head may have slipped."""
        head = rigid_move(self.head_rad, self.head_mm)
        return head @ inverse(rigid_move(self.slip_rad, self.slip_mm))


NOTHING_MOVED = RoomShift()


class ShiftedRoom:
    """Displacements caused by active room faults, cheap to query if there are none."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._board = FaultBoard(world, DEVICE)
        self._stiffness_N_mm = world.scene.arm.stiffness_N_mm
        head = world.scene.head
        self._head_centre_mm = apply(matrix_of(head.robot_from_ct), head.centre_ct_mm)
        self._tracker_mm = np.array(world.scene.tracker.robot_from_tracker.translation_mm)
        holders = world.scene.holders
        self._bases = {role: matrix_of(one.robot_from_base) for role, one in holders.items()}

    def robot_from_base(self, role: ArmRole, room: RoomShift) -> Matrix:
        """Return ROBOT <- base of an arm beside the master (4, 4) with a displacement of the room."""
        return rigid_move(room.assistant_rad, room.assistant_mm) @ self._bases[role]

    def now(self, later_s: float = 0.0) -> RoomShift:
        """Return the current displacements, or the object `NOTHING_MOVED` if there are no faults.

        With `later_s`, those to which the present motions will have come by then.
        """
        if self._board.empty:
            return NOTHING_MOVED
        now_s = self._world.clock.now_s() + later_s
        acting = [come_to(fault, onset_s, now_s) for fault, onset_s in self._board.acting_since()]
        shifts, turns, pushes, loose = (
            tuple(one for one in acting if one.kind is kind) for kind in (SHIFT, TURN, PUSH, LOOSEN)
        )
        cart_mm = _add_up([_sum_arguments(shifts, CART), *list_cart_rolls_mm(self._board, now_s)])
        push_N = _add_up([[float(each) for each in push.arguments] for push in pushes])
        knocked = matrix_from(cart_mm, rotation_from_vector(np.radians(_sum_arguments(turns, CART))))
        moves = [one for one in self._board.acting_since() if one[0].kind is MOVE]
        # Relative to a moved cart, all else moves back.
        from_cart = inverse(knocked @ cart_pose(moves, now_s, ArmRole.MASTER))
        back = from_cart[:3, :3]

        def moved(body: str, centre_mm: Matrix) -> Matrix:
            turn = rotation_from_vector(np.radians(_sum_arguments(turns, body)))
            return matrix_from(centre_mm - turn @ centre_mm + _sum_arguments(shifts, body), turn)

        def displaced(body: str, centre_mm: Matrix) -> Matrix:
            return from_cart @ moved(body, centre_mm)

        slip = moved(SLIPPING_HEAD, self._head_centre_mm)
        head = displaced(HEAD, self._head_centre_mm) @ slip
        tracker = displaced(TRACKER, self._tracker_mm)
        base = self._bases.get(ArmRole.ASSISTANT, IDENTITY)
        wheeled = base @ cart_pose(moves, now_s, ArmRole.ASSISTANT) @ inverse(base)
        assistant = displaced(ASSISTANT_CART, base[:3, 3]) @ wheeled
        guide_mm = np.divide(push_N, self._stiffness_N_mm) + _sum_arguments(shifts, GUIDE)
        return RoomShift(
            head_mm=as_point(head[:3, 3]),
            tracker_mm=as_point(tracker[:3, 3]),
            head_rad=as_point(vector_from_rotation(head[:3, :3])),
            tracker_rad=as_point(vector_from_rotation(tracker[:3, :3])),
            guide_mm=as_point(back @ guide_mm),
            push_N=as_point(back @ np.array(push_N)),
            guide_rad=as_point(back @ np.radians(_sum_arguments(turns, GUIDE))),
            assistant_mm=as_point(assistant[:3, 3]),
            assistant_rad=as_point(vector_from_rotation(assistant[:3, :3])),
            seat_mm=_sum_arguments(shifts, SEAT),
            seat_rad=as_point(np.radians(_sum_arguments(turns, SEAT))),
            slip_mm=as_point(slip[:3, 3]),
            slip_rad=as_point(vector_from_rotation(slip[:3, :3])),
            spheres_mm=tuple(
                (int(number), as_point(back @ np.array(_sum_arguments(loose, number))))
                for number in sorted({one.argument for one in loose})
            ),
            extra_spheres_mm=tuple(
                as_point(apply(from_cart, np.array([float(number) for number in one.arguments])))
                for one in acting
                if one.kind is EXTRA_SPHERE
            ),
        )


def rigid_move(turn_rad: Point, shift_mm: Point) -> Matrix:
    """Return the transform (4, 4) of a rotation about the robot's origin followed by a translation."""
    return matrix_from(shift_mm, rotation_from_vector(turn_rad))


def yielding_flange(flange: Matrix, flange_from_marker: Matrix, room: RoomShift) -> Matrix:
    """Return ROBOT <- FLANGE (4, 4) of an arm yielding to a hand pushing its tool."""
    if not any((*room.guide_mm, *room.guide_rad)):
        return flange
    about_mm = (flange @ flange_from_marker)[:3, 3]
    turn = rotation_from_vector(room.guide_rad)
    held = flange.copy()
    held[:3, :3] = turn @ flange[:3, :3]
    held[:3, 3] = turn @ (flange[:3, 3] - about_mm) + about_mm + room.guide_mm
    return held


def list_cart_rolls_mm(board: FaultBoard, now_s: float) -> tuple[Point, ...]:
    """Return how far the cart has rolled for each fault since its brakes were released, in mm."""
    return tuple(
        _add_up([[float(rate) * (now_s - onset_s) / SECONDS_PER_MINUTE for rate in fault.arguments]])
        for fault, onset_s in board.acting_since()
        if fault.kind is UNLOCKED
    )


def spheres_in_theatre(scene: Scene) -> tuple[Fiducial, ...]:
    """Return the spheres as refitted in the theatre, in scene order and the CT frame (mm)."""
    return tuple(_refit(one, scene) for one in scene.head.fiducials if not one.missing)


def _refit(sphere: Fiducial, scene: Scene) -> Fiducial:
    """Move a sphere to its refitted position on the base now attached to its screw."""
    place_mm = np.array(sphere.centre_ct_mm) + sphere.displaced_mm
    place_mm += noise(scene.seed, SEATING, sphere.number).normal(0.0, scene.head.seating_error_mm, 3)
    wanted = sphere.base_in_theatre or sphere.number
    base = next(one for one in scene.head.fiducials if one.number == wanted)
    place_mm += (base.base_mm - sphere.base_mm) * np.array(sphere.post_ct)
    x, y, z = place_mm.tolist()
    worn = {"radius_mm": base.radius_mm, "worn_percent": base.worn_percent}
    return sphere.model_copy(update={"centre_ct_mm": (x, y, z), **worn})


def _sum_arguments(faults: tuple[Fault, ...], what: str) -> Point:
    return _add_up(
        [[float(number) for number in fault.arguments[1:]] for fault in faults if fault.argument == what]
    )


def _add_up(ways: Sequence[Sequence[float]]) -> Point:
    return as_point(sum(column) for column in zip(*ways, strict=True)) if ways else STILL
