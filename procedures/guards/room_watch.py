"""Watch over the room since the localization: every look is held against all looks before it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.special import chdtri

from procedures.engine.setting import CaseMemory
from procedures.guards import room_motion
from procedures.guards.errors import BaseShifted, InsertionDisturbed, PatientUnseen, RoomMoved, RoomUndecided
from procedures.guards.head_frames import ENOUGH_IN_PLACE
from procedures.guards.head_sight import HeadSight
from procedures.guards.room_reading import (
    AS_KNOWN,
    CAREFUL_FRAMES,
    FRAMES,
    ArrivedSides,
    RoomReading,
    room_reading,
)
from procedures.planning.tracker_sight import TrackerSight
from procedures.registration.movement import LEAST_POINTS
from procedures.room.estimate import AXES, FALSE_ALARM, GUIDE_AT_HEAD, Displacement, RoomEstimate
from procedures.room.model import Body, Places, Rows, TrackedArm
from procedures.room.motion import Moved, RoomMotion, find_hidden_motion, find_motion
from procedures.room.sighting import SeenFrame, Sighting, Tracked, expect_frame, expect_spheres
from procedures.strategies.strategy import ONE_SIDE
from procedures.workcell import Workcell
from procedures.workcell.arm_history import stands_at
from procedures.workcell.patient_frame import seen_after
from procedures.workcell.tracker_look import read_frames_at_rest
from procedures.workcell.tracker_move import STILL, UNPUSHED, TrackerMove
from ronna_hw.arrays import Array
from ronna_hw.devices.crossed_sight import SENSORS_MM
from ronna_hw.devices.readings import TrackerFrame
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector, Vector3

Refusal = RoomMoved | InsertionDisturbed | RoomUndecided | PatientUnseen
FlangePose = Callable[[JointVector, Sequence[int] | None], Transform]  # ROBOT <- FLANGE

TOUCHED_S = 3.0  # theatre time after which a hand that touched the arm in passing is gone


@dataclass(frozen=True)
class JudgedReading:
    """Reading held against all looks before: the look that it is, its rows, and the motion that it shows."""

    reading: RoomReading
    look: Sighting
    rows: Rows
    motion: RoomMotion | None = None


@dataclass(frozen=True)
class RoomLook:
    """Result of a look at the room: distances of head and frame on the arm from where they are expected.

    `head_mm` is the rms over its points, `base_mm` that of the frame's origin; None where not seen. `moved`
    is the error that names what has moved, or what hides it; `findings` stop nothing. `by_frame` says that
    the frame on the clamp stands for the head, and `spheres_hidden` that it does so for spheres out of view.
    """

    judged: JudgedReading
    head_mm: float | None
    base_mm: float | None
    findings: tuple[str, ...] = ()
    moved: Refusal | None = None
    by_frame: bool = False
    spheres_hidden: bool = False

    @property
    def reading(self) -> RoomReading:
        return self.judged.reading

    @property
    def in_place(self) -> bool:
        """Whether head and base were seen and unmoved. The tracker may have moved."""
        return self.moved is None and self.head_mm is not None and self.base_mm is not None

    def require(self) -> tuple[str, ...]:
        """Return the findings. Raises `moved` if set.

        Raises PRO-019 if the cart was moved, PRO-020 if the head has, PRO-022 if a sphere near the head is at
        no known position, CAL-023 if the assistant's cart was moved, PRO-051 if the patient's frame has
        slipped on the clamp, PRO-052 if the arm's pose does not tell what was moved, PRO-054 if the assistant
        is beside its axis with an instrument in the guide.
        """
        if self.moved is not None:
            raise self.moved
        return self.findings


@dataclass
class RoomWatch:
    """Watch over the spheres and frames of one global localization.

    There is one tracker frame, that of the localization: all places are in it, and every tracker frame read
    later is expressed in it first (`as_localized`). A tracker that has moved is followed where head and arm
    agree on it, and `tracker_moved` is told; `keep` is told every look that counts. `points_mm` are the
    targets (3,), robot frame. `bases` is the result by which an assistant is in the estimate.
    """

    localization: str  # identifier of the record
    robot_from_tracker: Transform
    estimate: RoomEstimate
    flange_poses: dict[Tracked, FlangePose]
    looks: list[Sighting]  # all that count
    epochs: list[Places]  # where the head is expected: as localized, and after each move that was followed
    points_mm: Mapping[str, Array] = field(default_factory=dict)
    clamp_markers_mm: Array | None = None  # (m, 3) of the frame on the clamp, patient frame
    tracker: TrackerMove = UNPUSHED  # since the localization
    tracker_moved: Callable[[TrackerMove], None] = lambda _move: None
    keep: Callable[[Sighting], None] = lambda _look: None
    bases: object = None
    head_sight: HeadSight = field(default_factory=HeadSight)
    epoch: int = 0  # of the head, the present one
    _by_frame_only: bool = False  # as told last

    @property
    def settled_home(self) -> int:
        """Number of the last look with the arm settled home, 0 if that is the localization."""
        home_rad = self.looks[0].arms[Tracked.ARM].joints_rad
        rests = ((number, look.arms.get(Tracked.ARM)) for number, look in enumerate(self.looks))
        at_home = (
            number
            for number, rest in rests
            if rest is not None and rest.sides == ONE_SIDE and stands_at(rest.joints_rad, home_rad)
        )
        return max(at_home, default=0)

    @property
    def gross_limit_mm(self) -> float:
        """Way of the frame on the arm that a rolled cart alone explains where it was never seen before.

        At least `GROSS_LIMIT_MM`, which rules out a hand. An error of the tool frame goes unseen where the
        tracker was localized, and displaces the frame by up to twice as much once the flange has turned.
        """
        tool_mm = self.estimate.model.arms[Tracked.ARM].sizes.tool_mm
        return max(room_motion.GROSS_LIMIT_MM, 2.0 * tool_mm * math.sqrt(float(chdtri(AXES, FALSE_ALARM))))

    @property
    def spheres_mm(self) -> Array:
        """Expected spheres (n, 3), tracker frame."""
        return self.epochs[self.epoch].spheres_mm

    @property
    def clamp_mm(self) -> Array | None:
        """Expected markers (m, 3) of the frame on the clamp, tracker frame; None if it stands for nothing."""
        pose = self.epochs[self.epoch].clamp
        if pose is None or self.clamp_markers_mm is None:
            return None
        return np.asarray(self.clamp_markers_mm @ pose[:3, :3].T + pose[:3, 3])

    def follow(self, spheres_mm: Array | None, on_clamp: Transform | None = None) -> None:
        """Set the expected sphere positions (n, 3), or restore the localized ones with None.

        With the spheres, the pose of the patient's frame is set: without one, as while it was hidden when
        they were measured, nothing stands in for them.
        """
        if spheres_mm is None:
            self.epoch = 0
            return
        for number, known in enumerate(self.epochs[1:], start=1):
            if np.array_equal(known.spheres_mm, spheres_mm):
                self.epoch = number
                return
        clamp = None if on_clamp is None or self.epochs[0].clamp is None else on_clamp.as_matrix()
        self.epochs.append(Places(spheres_mm, clamp))
        self.epoch = len(self.epochs) - 1
        self._begin_epoch()

    def expect_clamp(self) -> dict[Tracked, SeenFrame]:
        """Return the frame on the clamp as a careful look would give it; empty if it stands for nothing."""
        pose = self.epochs[self.epoch].clamp
        if pose is None or self.clamp_markers_mm is None:
            return {}
        seen = expect_frame(pose[:3, 3], pose[:3, :3], self.clamp_markers_mm, CAREFUL_FRAMES)
        return {Tracked.CLAMP: seen}

    def _begin_epoch(self) -> None:
        """Count the reading by which a move of the head was measured as the first look since."""
        seen = expect_spheres(self.spheres_mm, CAREFUL_FRAMES)
        look = Sighting({}, seen, self.expect_clamp(), self.tracker.pushes, self.epoch)
        self._count(look, self._rows(look))
        self.keep(look)

    def restore(self, looks: Sequence[Sighting]) -> None:
        """Count the looks of an earlier program again.

        The first look after a move that was followed is the reading by which that was measured.
        """
        for look in looks:
            if look.head == len(self.epochs):
                clamp = look.frames.get(Tracked.CLAMP)
                pose = None if clamp is None or self.epochs[0].clamp is None else clamp.pose
                self.epochs.append(Places(look.spheres.places_mm, pose))
            self._count(look, self._rows(look))

    def take_in_assistant(
        self, bases: object, arm: TrackedArm, flange_pose: FlangePose, first_look: int
    ) -> RoomMotion | None:
        """Take the assistant into the estimate, by the frame on it in look `first_look` and later.

        `bases` is the result by which it is known. Return the motion that the looks show with it, or None.
        """
        known = self.estimate.model
        arms = {**known.arms, Tracked.ASSISTANT: arm}
        self.estimate, self.bases = RoomEstimate(replace(known, arms=arms)), bases
        self.flange_poses[Tracked.ASSISTANT] = flange_pose
        looks, self.looks = self.looks, []
        for number, look in enumerate(looks):
            frames = dict(look.frames)
            if number < first_look:
                frames.pop(Tracked.ASSISTANT, None)
            counted = replace(look, frames=frames)
            self._count(counted, self._rows(counted))
        return find_hidden_motion(self.estimate, self.points_mm, first_look)

    def _count(self, look: Sighting, rows: Rows) -> None:
        self.estimate = self.estimate.add(rows)
        self.looks.append(look)

    def frame_by_arm(self, arm: Tracked) -> FlangePose | None:
        """Return how joints have the frame on an arm, TRACKER <- MARKER, or None for an unknown arm."""
        known = self.estimate.model.arms.get(arm)
        if known is None:
            return None
        mount = Transform.from_matrix(Frame.FLANGE, Frame.MARKER, known.flange_from_marker)
        tracker, flange_pose = self.robot_from_tracker.inverse(), self.flange_poses[arm]
        return lambda joints_rad, sides: tracker @ flange_pose(joints_rad, sides) @ mount

    def as_localized(self, frame: TrackerFrame) -> TrackerFrame:
        """Return a tracker frame as the tracker would have seen it from where it was at the localization."""
        return frame if self.tracker.move is STILL else seen_after(self.tracker.move.inverse(), frame)

    def read(
        self, workcell: Workcell, frames: list[TrackerFrame], sides: ArrivedSides = AS_KNOWN
    ) -> RoomReading:
        """Average tracker frames taken at the arm's current pose into a reading for `compare`."""
        localized = [self.as_localized(frame) for frame in frames]
        return room_reading(workcell, localized, self.robot_from_tracker, sides)

    @property
    def sights(self) -> tuple[TrackerSight, ...]:
        """Sight of the tracker, from where it is now, on the spheres and on the frame on the clamp."""
        move = self.tracker.move
        here = self.robot_from_tracker @ move.inverse()
        places = (self.spheres_mm, *(() if self.clamp_mm is None else (self.clamp_mm,)))
        return tuple(TrackerSight(here, move.apply(one)) for one in places if len(one))

    def compare(self, reading: RoomReading | JudgedReading, now_s: float = 0.0) -> RoomLook:
        """Hold a reading against all looks before, and count it among them if nothing has moved.

        A reading that was judged since the last look counted is not judged again.
        """
        judged = reading if isinstance(reading, JudgedReading) else self.judge(reading)
        judged, findings = self.follow_tracker(judged)
        reading, rows, motion, expected = judged.reading, judged.rows, judged.motion, self.expected(judged)
        head = room_motion.HeadSeen.of(expected)
        base_mm = None if expected.arm_way_mm is None else float(np.linalg.norm(expected.arm_way_mm))
        # Of a head with few spheres, or none, the frame on its clamp is what shows it.
        by_frame = head is not None and head.by_frame
        hidden = by_frame and len(self.spheres_mm) >= LEAST_POINTS
        moved: Refusal | None = None
        if motion is not None:
            at_head = self.head_sight.under_way or reading.on_axis
            moved = room_motion.name_motion(motion, expected, reading, approached=at_head)
        if moved is None:
            moved = room_motion.find_unseen(expected, reading)
        if moved is None and len(rows.residual):
            findings += self._tell_by_frame(hidden=hidden)
            self._count(judged.look, rows)
            self.keep(judged.look)
            if head is not None:
                self.head_sight.seen_s = now_s
        rms_mm = None if head is None else head.shift.rms_mm
        return RoomLook(judged, rms_mm, base_mm, findings, moved, by_frame, hidden)

    def judge(self, reading: RoomReading) -> JudgedReading:
        """Hold a reading against all looks before; it is not counted.

        Beside the place of a hidden sphere a ghost passes for that sphere. A motion that the look does not
        show without the points that may be ghosts is none, and the look is then without them. It takes
        `ENOUGH_IN_PLACE` other spheres to tell.
        """
        judged = self._judge(reading, self.look_of(reading))
        if judged.motion is None:
            return judged
        certain = self.look_of(reading, certain=True)
        if not ENOUGH_IN_PLACE <= len(certain.spheres.numbers) < len(judged.look.spheres.numbers):
            return judged
        without = self._judge(reading, certain)
        return judged if without.motion is not None else without

    def _judge(self, reading: RoomReading, look: Sighting) -> JudgedReading:
        judged = JudgedReading(reading, look, self._rows(look))
        if not len(judged.rows.residual):
            return judged
        found = find_motion(self.estimate, judged.rows, self._points_here_mm, partial(self._unpushed, judged))
        return replace(judged, motion=found or self._find_gross(judged.rows))

    @property
    def _points_here_mm(self) -> Mapping[str, Array]:
        """Targets that count now: with the guide at one of them, that one."""
        if not self.head_sight.under_way:
            return self.points_mm
        at = self.head_sight.trajectory
        return {name: point for name, point in self.points_mm.items() if name == at} or self.points_mm

    def _find_gross(self, rows: Rows) -> RoomMotion | None:
        """Return a motion of the base that is plain although the arm was never seen in this pose."""
        if Body.BASE not in rows.blocks:
            return None
        way_mm, limit_mm = self._arm_way_mm(rows), self.gross_limit_mm
        if (moved_mm := float(np.linalg.norm(way_mm))) < limit_mm:
            return None
        return RoomMotion(Moved.BASE, len(self.estimate.looks), moved_mm**2, limit_mm**2, way_mm)

    def with_look(self, look: Sighting, estimate: RoomEstimate | None = None) -> RoomEstimate:
        """Return the estimate, by default the present one, with a look that is only imagined."""
        return (estimate or self.estimate).add(self._rows(look))

    def including(self, judged: JudgedReading) -> RoomEstimate:
        """Return the estimate with a reading, whether that is counted by now or not."""
        return self.estimate if self.looks[-1] is judged.look else self.with_look(judged.look)

    def displacement_by(self, look: Sighting, point_mm: Array, bodies: Mapping[str, float]) -> Displacement:
        """Return by how much these bodies displace a point (3,), robot frame, as a look alone shows it."""
        return self.estimate.displacement_by(self._rows(look), point_mm, bodies)

    def expected(self, judged: JudgedReading) -> room_motion.Expected:
        """Return where everything is expected in a reading."""
        mount = self.estimate.model.arms[Tracked.ARM].flange_from_marker
        return room_motion.Expected(
            judged.look,
            self.spheres_mm,
            self.clamp_mm,
            self.robot_from_tracker,
            judged.reading.robot_from_flange @ Transform.from_matrix(Frame.FLANGE, Frame.MARKER, mount),
            self._arm_way_mm(judged.rows) if Body.BASE in judged.rows.blocks else None,
            self.sensors_mm,
        )

    def _arm_way_mm(self, rows: Rows) -> Array:
        return self.estimate.innovation(rows)[0][rows.blocks[Body.BASE]][:3]

    def changes_at(self, point: str) -> dict[str, tuple[float, float]]:
        """Return by body how far it may have displaced a target since the last look but one: estimate, limit.

        The limit is what the last look would have noticed half of the time, in any direction.
        """
        since = len(self.estimate.looks) - 1
        found = {}
        for body, sign in GUIDE_AT_HEAD.items():
            displacement = self.estimate.displacement(self.points_mm[point], since, {body: sign})
            way_mm = float(np.linalg.norm(displacement.way_mm))
            found[body] = way_mm, displacement.noticed_from_mm
        return found

    def follow_tracker(self, judged: JudgedReading) -> tuple[JudgedReading, tuple[str, ...]]:
        """If only the tracker was moved, follow it; only a careful reading decides.

        Return the reading as seen from where the tracker was, and the finding.
        """
        motion, reading = judged.motion, judged.reading
        if motion is None or motion.moved is not Moved.TRACKER or not reading.is_careful:
            return judged, ()
        push = room_motion.push_of_tracker(self.expected(judged))
        self.tracker = self.tracker.then(STILL if push is None else push)
        self.tracker_moved(self.tracker)
        if push is None:
            return self.judge(reading), ("the tracker was moved by little; arm and head agree",)
        at_head = self.spheres_mm if len(self.spheres_mm) else self.clamp_mm
        assert at_head is not None  # a head is watched by spheres, or by the frame on its clamp
        at_head_mm = math.sqrt(float(((push.apply(at_head) - at_head) ** 2).sum(axis=1).mean()))
        turned_deg = math.degrees(float(push.rigid.rotation.magnitude()))
        return self.judge(reading.moved_by(push.inverse(), self.robot_from_tracker)), (
            f"the tracker was moved: by {at_head_mm:.1f} mm as seen at the head, turned by {turned_deg:.2f} "
            "deg; head and arm agree on it, and the case goes on",
        )

    def _unpushed(self, judged: JudgedReading) -> Rows | None:
        push = room_motion.push_of_tracker(self.expected(judged))
        if push is None:
            return None
        unpushed = judged.reading.moved_by(push.inverse(), self.robot_from_tracker)
        return self._rows(self.look_of(unpushed))

    def look_of(self, reading: RoomReading, *, certain: bool = False) -> Sighting:
        """Return the look that a reading is; if `certain`, without points that may be ghosts."""
        pushes, epoch = self.tracker.pushes, self.epoch
        return reading.sighting(self.spheres_mm, self.sensors_mm, tracker=pushes, head=epoch, certain=certain)

    @property
    def sensors_mm(self) -> Array:
        """Sensors of the tracker (2, 3) where it is now, in its frame of the localization."""
        return np.asarray(self.tracker.move.inverse().apply(SENSORS_MM))

    def _rows(self, look: Sighting) -> Rows:
        flanges = {
            name: self.flange_poses[name](rest.joints_rad, rest.sides).as_matrix()
            for name, rest in look.arms.items()
            if name in self.flange_poses
        }
        return self.estimate.model.rows(look, flanges, self.epochs[look.head])

    def _tell_by_frame(self, *, hidden: bool) -> tuple[str, ...]:
        """Return a finding when the spheres have become hidden and only the frame on the clamp is watched."""
        is_new = hidden and not self._by_frame_only and len(self.spheres_mm) > 0
        self._by_frame_only = hidden
        if not is_new:
            return ()
        return ("the spheres on the head are hidden: the frame on its clamp is watched in their place",)

    def frame_off_arm_mm(self, seen_mm: Vector3, begin_mm: Vector3, end_mm: Vector3) -> float | None:
        """Return the distance of the frame on a moving arm from the arm's way, or None within the limit.

        `seen_mm` is its position in one tracker frame, tracker frame. The arm had it at `begin_mm` before
        that frame and at `end_mm` after it, robot frame. The limit grows by the way between: the arm may
        report late.
        """
        way_mm = np.subtract(end_mm, begin_mm)
        gone_mm = self.robot_from_tracker.apply(seen_mm) - begin_mm
        length_mm = math.hypot(*way_mm)
        share = float(gone_mm @ way_mm) / length_mm**2 if length_mm > 0.0 else 0.0
        off_mm = math.hypot(*(gone_mm - min(1.0, max(0.0, share)) * way_mm))
        return off_mm if off_mm > self.gross_limit_mm + length_mm else None


def read_watched(
    room: RoomWatch, workcell: Workcell, count: int = FRAMES, sides: ArrivedSides = AS_KNOWN
) -> JudgedReading:
    """Read the room with the arm at rest; carefully, if a short reading shows that something has moved."""
    judged = room.judge(room.read(workcell, read_frames_at_rest(workcell, count=count)[0], sides))
    if judged.reading.is_careful or judged.motion is None:
        return judged
    return room.judge(room.read(workcell, read_frames_at_rest(workcell, count=CAREFUL_FRAMES)[0], sides))


def check_now(
    room: RoomWatch,
    workcell: Workcell,
    memory: CaseMemory,
    void: Callable[[RonnaError], None],
    count: int = FRAMES,
    sides: ArrivedSides = AS_KNOWN,
) -> RoomLook:
    """Check the room now and raise like `RoomLook.require`. A movement voids results and ends the watch.

    An arm at home that is not in its place is looked at once more after a moment: a hand may have touched it.
    """
    look = room.compare(read_watched(room, workcell, count, sides), workcell.clock.now_s())
    if isinstance(touched := look.moved, BaseShifted) and look.reading.settled_home and touched.cart:
        workcell.clock.sleep(TOUCHED_S)
        look = room.compare(read_watched(room, workcell, CAREFUL_FRAMES, sides), workcell.clock.now_s())
        if look.moved is None:
            found = f"for a moment {touched.what}; it is back in its place: somebody has touched the arm"
            look = replace(look, findings=(*look.findings, found))
    if isinstance(look.moved, RoomMoved):
        void(look.moved)  # first: the watch goes on until this is written
    if isinstance(look.moved, RoomMoved | RoomUndecided):
        memory.drop(RoomWatch)  # the same move must not stop the way out
    look.require()
    return look
