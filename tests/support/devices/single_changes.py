"""Single changes between looks at home, in this process: the guards' code against the truth at the target.

After the registration, before each target and after each retreat the arm is at home and the tracker looks.
Something moves at most once. The arm's repeatability and the play of its gears are those of the true arm, the
tracker's bias and noise those of the simulator. Any object that is told of each look can be judged.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from room_trials import TrackedCase

from procedures.guards.errors import BaseShifted, PatientMoved, PatientUnseen
from procedures.guards.room_watch import RoomReading, RoomWatch
from ronna_hw.frames import Frame, Transform
from sim.polaris.measurement.rigid_fit import fit_rigid_body
from sim.world.rigid import apply, inverse, matrix_from, matrix_of, rotation_from_vector

Array = NDArray[np.float64]
STILL = np.eye(4)

MOST_MM, MOST_DEG = 3.0, 1.0
SIGMAS_OF_LIMIT = 2.795  # radius that holds 95 % of three equal normal errors, in sigmas of each
HIDDEN_SHARE = 0.5
Sides = Sequence[float]
SAME_SIDES: Sides = (1.0,) * 6


class Moved(StrEnum):
    """What moves."""

    NOTHING = "nothing"
    HEAD = "head"
    CART = "cart"


@dataclass(frozen=True)
class Look:
    """One look of the tracker from home: the frame on the arm and the spheres, tracker frame."""

    robot_from_flange: Transform
    tracker_from_frame: Transform
    spheres_mm: Array


class Watch(Protocol):
    """Anything that is told of each look. True when it would not let the result stand without a word."""

    def look(self, look: Look) -> bool:
        """Take a look; the first one is the reference."""
        ...


class PresentWatch:
    """The watch of the present code, told of the same looks."""

    def __init__(self, case: TrackedCase) -> None:
        self._case = case
        self._watch: RoomWatch | None = None

    def look(self, look: Look) -> bool:
        by_arm = self._case.frame_by_arm(look.robot_from_flange)
        if self._watch is None:
            from_tracker = by_arm @ look.tracker_from_frame.inverse()
            reading = RoomReading(look.robot_from_flange, np.zeros(3), look.spheres_mm)
            self._watch = RoomWatch("trial", from_tracker, look.spheres_mm, [reading])
            return False
        seen = self._watch.robot_from_tracker @ look.tracker_from_frame
        way_mm = seen.translation_mm - by_arm.translation_mm
        try:
            return bool(self._watch.check(RoomReading(look.robot_from_flange, way_mm, look.spheres_mm)))
        except (BaseShifted, PatientMoved, PatientUnseen):
            return True


@dataclass(frozen=True)
class Trial:
    """One case: true errors (n,) of its targets in units of their limit, and those warned of."""

    moved: Moved
    ratios: Array
    warned: NDArray[np.bool_]

    def unseen(self, times: float) -> int:
        """How many targets have an error beyond so many times their limit without a word."""
        return int(((self.ratios > times) & ~self.warned).sum())


def trial(
    case: TrackedCase,
    watch: Watch,
    moved: Moved,
    *,
    frames: int = 60,
    limit_mm: float = 0.3,
    sides: Callable[[], Sides] = lambda: SAME_SIDES,
) -> Trial:
    """One case at the targets of its scene; what moves does so at a random moment after the first look.

    `sides` draws on which side of its play each joint rests at a visit of home.
    """
    generator = case.generator
    head = case.scene.head
    targets_mm = apply(matrix_of(head.robot_from_ct), [one.target_ct_mm for one in head.targets])
    move = _move(generator, case, moved)
    begins = int(
        generator.integers(2 * len(targets_mm))
    )  # even: before that target's first look; odd: after it
    hidden = moved is not Moved.NOTHING and generator.uniform() < HIDDEN_SHARE
    visible = generator.permutation(len(case.spheres_mm))[int(generator.integers(len(case.spheres_mm))) :]
    lasts = int(generator.integers(1, 4))  # looks for which it hides them

    def look(moment: int, now: Array) -> bool:
        shown = visible if hidden and begins <= moment < begins + lasts else range(len(case.spheres_mm))
        return watch.look(_look(case, moved, now, frames, sides(), sorted(shown)))

    watch.look(_look(case, moved, STILL, frames, sides(), range(len(case.spheres_mm))))
    ratios, warned = np.zeros(len(targets_mm)), np.zeros(len(targets_mm), dtype=bool)
    for number, target_mm in enumerate(targets_mm):
        if look(2 * number, move if begins <= 2 * number else STILL):
            warned[number:] = True  # it does not go there
            break
        there = begins <= 2 * number + 1
        own_mm = generator.standard_normal(3) * limit_mm / SIGMAS_OF_LIMIT
        way_mm = apply(move, target_mm) - target_mm if there else np.zeros(3)
        ratios[number] = np.linalg.norm(own_mm + way_mm) / limit_mm
        if look(2 * number + 1, move if there else STILL):
            warned[number:] = True
            break
    return Trial(moved, ratios, warned)


def _move(generator: np.random.Generator, case: TrackedCase, moved: Moved) -> Array:
    """How the head moves in the robot's frame: itself, or since the robot does (4, 4)."""
    if moved is Moved.NOTHING:
        return STILL
    shift_mm, turn_rad = case.direction() * generator.uniform(0.0, MOST_MM), case.direction()
    turn = rotation_from_vector(turn_rad * math.radians(generator.uniform(0.0, MOST_DEG)))
    if moved is Moved.CART:
        return inverse(matrix_from(shift_mm, turn))
    head = case.scene.head
    centre_mm = apply(matrix_of(head.robot_from_ct), head.centre_ct_mm)
    return matrix_from(shift_mm + centre_mm - turn @ centre_mm, turn)


def _look(
    case: TrackedCase, moved: Moved, now: Array, frames: int, sides: Sides, shown: Sequence[int]
) -> Look:
    """A look while the head is there in the robot's frame; with a moved cart the tracker is too."""
    flange = case.flange_at_rest(case.home_rad, sides, int(case.generator.integers(1, 1 << 30)))
    from_robot = case.tracker_from_robot @ (inverse(now) if moved is Moved.CART else STILL)
    body, spheres = case.read(from_robot, flange, apply(now, case.spheres_mm), frames)
    fit = fit_rigid_body(case.body_mm, body)
    pose = Transform.from_matrix(Frame.TRACKER, Frame.MARKER, matrix_from(fit.translation_mm, fit.rotation))
    return Look(case.kinematics.flange_pose(case.home_rad), pose, spheres[list(shown)])
