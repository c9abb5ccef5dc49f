"""Approaches with spheres covered for part of the time, in this process: by arm, head, hands or drapes.

What hides what is the simulator's; guard, watch and checks are the real ones, fed frame by frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property

import numpy as np
from frame_trials import shuffled_frame
from numpy.typing import NDArray
from room_trials import STILL, TrackedCase

from procedures.guards.errors import BaseShifted, PatientMoved, PatientUnseen, RoomUndecided
from procedures.guards.head_frames import PATIENT_LIMIT_MM, HeadFrames
from procedures.guards.room_reading import FRAMES
from procedures.guards.watch_thread import SKIPPED_FRAMES
from procedures.planning.tracker_sight import TrackerSight
from procedures.registration.movement import LEAST_POINTS, measure_shift
from ronna_hw.arm.clearance.bodies import Part, Surroundings
from ronna_hw.arm.pose import Pose
from ronna_hw.collision_config import CollisionConfig
from ronna_hw.frames import Frame
from ronna_hw.vectors import JointVector
from sim.polaris.measurement.line_of_sight import ArmBody, head_ellipsoid, visible
from sim.polaris.measurement.optics import EYES_MM
from sim.world.rigid import apply
from sim.world.world import ArmState

Flags = NDArray[np.bool_]

FRAMES_S = 60.0
GO_FRAMES, INSERT_FRAMES = 96, 180  # as the mini case takes
LONGEST_HOLD_FRAMES, LONGEST_COVER_FRAMES = 1200, 1200
PLACES = 9  # along a motion at which the arm's shadow is computed


class GuideSight:
    """Which spheres of a scene the tracker sees past the guide: truly, and as the planner expects it."""

    def __init__(self, case: TrackedCase) -> None:
        scene = case.scene
        self._case, self._guide = case, scene.mount.tool_number_guide
        self._body = ArmBody(scene)
        self._head = head_ellipsoid(scene.head, case.tracker_from_robot)
        self._spheres_mm = apply(case.tracker_from_robot, case.spheres_mm)
        tool = case.records.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
        in_flange = Pose.from_matrix(tool.as_matrix().tolist())
        guide = CollisionConfig().guide
        parts = (Part(one.name, one.capsule.moved(in_flange), one.enters_head) for one in guide)
        self._around = Surroundings(tool=tuple(parts))
        self._known: dict[JointVector, Flags] = {}

    def seen(self, joints: JointVector) -> Flags:
        """Which spheres (n,) the tracker truly sees."""
        if joints not in self._known:
            arm = ArmState(joints, self._case.true_flange(joints), 0, True)
            capsules = self._body.capsules(arm, self._guide, self._case.tracker_from_robot)
            seen = visible(EYES_MM, self._spheres_mm, (self._head, capsules))
            self._known[joints] = seen.all(axis=0)
        return self._known[joints]

    def expected(self, joints: JointVector) -> Flags:
        """Which spheres (n,) it is expected to see."""
        watch = self._case.begin()
        sight = TrackerSight(watch.robot_from_tracker, watch.spheres_mm)
        return sight.seen(self._case.kinematics, self._around, joints)

    @cached_property
    def approaches(self) -> list[tuple[JointVector, JointVector]]:
        """Over and at each target."""
        rests = self._case.rests
        targeting = rests[-3 * ((len(rests) - 2) // 4) :]
        return list(zip(targeting[::3], targeting[1::3], strict=True))


class Moved(StrEnum):
    """What is shifted in a trial."""

    NOTHING = "nothing"
    HEAD = "head"
    CART = "cart"


class How(StrEnum):
    """How a trial ended."""

    NOTICED = "noticed"
    HELD = "held unseen"  # PRO-022, before a motion
    SUSPENDED = "suspended unseen"  # the bound
    PASSED = "nothing was noticed"


@dataclass(frozen=True)
class Ended:
    """`begun` counts the motions towards the head that began more than a reading of 0.2 s after the shift."""

    how: How
    begun: int
    unseen_s: float  # at the begin of the last of them
    arm_hides: bool = False  # at the target itself
    expected: bool = False  # that it does


@dataclass
class CoveredApproach:
    """One trial: home, over a target, onto it, the work there. Raises what the guards raise."""

    case: TrackedCase
    sight: GuideSight
    moved: Moved
    shift_mm: float
    covers: bool

    def __post_init__(self) -> None:
        generator = self.case.generator
        targets = self.sight.approaches
        self._over, self._at = targets[int(generator.integers(len(targets)))]
        self._hold = int(generator.integers(LONGEST_HOLD_FRAMES))
        whole = 3 * FRAMES + GO_FRAMES + INSERT_FRAMES + self._hold
        self._shift = int(generator.integers(whole))
        self._way_mm = self.case.direction() * self.shift_mm
        self._from = int(generator.integers(-LONGEST_COVER_FRAMES // 2, whole))
        self._until = self._from + int(generator.integers(LONGEST_COVER_FRAMES))
        count = len(self.case.spheres_mm)
        some = generator.random(count) < 0.5
        self._covered = some if generator.random() < 0.5 else np.ones(count, dtype=bool)
        self._frame, self._begun, self._unseen_s = 0, 0, 0.0
        self._watch = self.case.begin()
        self._frames = HeadFrames(self._watch.spheres_mm)

    def run(self) -> Ended:
        """Until the guide is out again."""
        try:
            how = self._run()
        except (PatientMoved, BaseShifted, RoomUndecided):
            how = How.NOTICED
        except PatientUnseen:
            how = How.HELD
        hidden, expected = (
            int(seen(self._at).sum()) < LEAST_POINTS for seen in (self.sight.seen, self.sight.expected)
        )
        return Ended(how, self._begun, self._unseen_s, hidden, expected)

    def _run(self) -> How:
        home, watch = self.case.home_rad, self._watch
        for place in self.case.rests[1 : len(self.case.rests) // 4 + 1]:  # as the stereo head visited them
            watch.compare(self.case.reading(watch, place)).require()
        watch.head_sight.seen_s = 0.0
        self._rest(home)
        if not self._head_seen:
            return How.HELD
        watch.head_sight.expect_approach(lambda: False)
        watch.head_sight.under_way = True
        for start, end, frames in ((home, self._over, GO_FRAMES), (self._over, self._at, INSERT_FRAMES)):
            if self._move(start, end, frames) or self._rest(end):
                return How.SUSPENDED
        if self._move(self._at, self._at, self._hold):
            return How.SUSPENDED
        if watch.head_sight.is_overdue(self._now_s):  # the guard looks itself when the work is done
            self._rest(self._at)
            if watch.head_sight.is_overdue(self._now_s):
                return How.SUSPENDED
        self._covered[:] = False  # at the latest when the guide is out hands and drapes go
        watch.head_sight.under_way = False
        self._move(self._at, self._over, INSERT_FRAMES)
        self._rest(self._over)
        return How.PASSED

    @property
    def _now_s(self) -> float:
        return self._frame / FRAMES_S

    @property
    def _has_shifted(self) -> bool:
        return self.moved is not Moved.NOTHING and self._frame >= self._shift

    def _visible(self, joints: JointVector) -> Flags:
        seen = self.sight.seen(joints)
        if self.covers and self._from <= self._frame < self._until:
            seen = seen & ~self._covered
        return seen

    def _rest(self, joints: JointVector) -> bool:
        """A reading at rest; whether the head is overdue then."""
        way_mm = self._way_mm if self._has_shifted else STILL
        head_mm = way_mm if self.moved is Moved.HEAD else STILL
        cart_mm = way_mm if self.moved is Moved.CART else STILL
        seen = self._visible(joints)
        whole = self.case.reading(self._watch, joints, head_mm, cart_mm)
        self._frame += FRAMES
        groups = tuple(group for group, is_seen in zip(whole.groups, seen, strict=True) if is_seen)
        reading = replace(whole, groups=groups)
        self._head_seen = measure_shift(self._watch.spheres_mm, reading.spheres_mm) is not None
        self._watch.compare(reading, self._now_s).require()
        return self._watch.head_sight.is_overdue(self._now_s)

    def _move(self, start: JointVector, end: JointVector, frames: int) -> bool:
        """A motion, or a wait, watched; whether it was stopped because the head is overdue."""
        due = self._has_shifted and self._frame - self._shift > FRAMES
        if due and self._watch.head_sight.under_way and start != end:
            self._begun += 1
            self._unseen_s = self._watch.head_sight.unseen_s(self._now_s)
        places = list(self._places(start, end))
        last, still_mm = self._frame + frames, self.case.spheres_mm
        while self._frame < last:
            share = 1.0 - (last - self._frame) / frames
            seen = self._visible(places[round(share * (PLACES - 1))])
            shifted = self._has_shifted and self.moved is Moved.HEAD
            places_mm = self.case.measured(still_mm + (self._way_mm if shifted else STILL))[seen]
            self._frames.add_frame(shuffled_frame(places_mm, self.case.generator))
            if self._frames.seen:
                self._watch.head_sight.seen_s = self._now_s
            if (self._frames.moved_mm or 0.0) >= PATIENT_LIMIT_MM:
                raise PatientMoved("on the way")
            if self._watch.head_sight.is_overdue(self._now_s):
                return True
            self._frame += 1 if self._frames.doubtful else 1 + SKIPPED_FRAMES
        return False

    def _places(self, start: JointVector, end: JointVector) -> Iterator[JointVector]:
        for share in np.linspace(0.0, 1.0, PLACES):
            A1, A2, A3, A4, A5, A6 = (float(a + share * (b - a)) for a, b in zip(start, end, strict=True))
            yield (A1, A2, A3, A4, A5, A6)
