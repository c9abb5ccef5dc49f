"""Tracker reading of the frame on the arm and all spheres, with the arm at rest.

Some of the spheres are ghosts, where the lines of sight to two different markers cross. Each of the tracker's
two sensors knows a marker only as a line. Two markers in one plane with both sensors produce, besides their
own places, up to two crossings without any marker. A marker seen by one sensor alone is not reported and yet
takes part, so a half hidden head shows points at no known position. A ghost is on one sensor's line to one
marker and on the other sensor's line to another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.registration.movement import LEAST_POINTS, NEAR_MM, identify_points
from procedures.room.sighting import (
    Rest,
    SeenFrame,
    SeenSpheres,
    Sighting,
    Tracked,
    average_frame,
    mean_covariance,
)
from procedures.workcell import Workcell
from procedures.workcell.patient_frame import seen_after
from procedures.workcell.tracker_look import (
    find_frame_name,
    list_poses,
    marker_shares,
    mean_pose,
    robot_from_marker,
)
from ronna_hw.arrays import Array
from ronna_hw.devices.crossed_sight import SENSORS_MM
from ronna_hw.devices.readings import TrackerFrame
from ronna_hw.devices.strays import LEAST_SHARE, StrayGroup, average_strays
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Frame, Transform
from ronna_hw.roles import ASSISTANT, MASTER

ArrivedSides = Mapping[Tracked, Sequence[int] | None]  # from which the joints of an arm have arrived
AS_KNOWN: ArrivedSides = MappingProxyType({})
ON_ARM: Mapping[str, Tracked] = MappingProxyType(
    {MASTER: Tracked.ARM, ASSISTANT: Tracked.ASSISTANT}
)  # by role

FRAMES = 12  # 0.2 s of the usual 60 Hz
CAREFUL_FRAMES = 60
# Safety against a ghost or a glint that is taken for a sphere (U).
LINE_MM = 1.0  # from a line: the tracker's bias differs between places by some tenths
OTHER_LINE_MM = 4.0  # to a marker on the arm, perhaps located by the arm alone: its mount is off by 3.5 mm
# Of spheres that are reported as one frame: how they sit differs from its definition, so the frame moves when
# one of them is hidden; per axis (U).
# Safety against a moved head within the fit of its frame.
FITTED_MM = 0.05

SENSOR_MM = 10.0  # uncertainty of the sensors' positions; matters in proportion to the way along the line


@dataclass(frozen=True, kw_only=True)
class RoomReading:
    """Mean of tracker frames with the arm at rest.

    `rests` are how the arms rest, by the frame on each; `robot_from_flange` is the pose of the master there,
    by its calibration if there is one. In the tracker's frame, `groups` are the strays and `markers_mm` (k,
    3) the markers of all tools in view; `frames` are the tracked frames. `frame_mm` (3,) is the frame on the
    arm by the tracker minus that by the arm, robot frame; None while it is not seen. `settled_home` says that
    the arm is home, each joint from its usual side; `on_axis` that a guide is at the head; `fitted` that the
    tracker has the spheres by fitting the frame that they are on. `instrument_led`: an arm leads an
    instrument.
    """

    robot_from_flange: Transform
    rests: Mapping[Tracked, Rest]
    frame_mm: Array | None
    groups: tuple[StrayGroup, ...]
    markers_mm: Array
    frames: Mapping[Tracked, SeenFrame]
    count: int
    settled_home: bool = False
    on_axis: bool = False
    fitted: bool = False
    instrument_led: bool = False
    tracker_frames: Sequence[TrackerFrame] = field(default=(), repr=False)

    @property
    def spheres_mm(self) -> Array:
        """Strays (m, 3), tracker frame."""
        return np.array([group.mean_mm for group in self.groups]).reshape(-1, 3)

    @property
    def head_mm(self) -> Array:
        """Points (m, 3) that move with the head, tracker frame: strays, else markers of the clamp's frame.

        Fewer than three strays do not show how a head has moved.
        """
        on_clamp = self.frames.get(Tracked.CLAMP)
        by_frame = on_clamp is not None and len(self.groups) < LEAST_POINTS
        return on_clamp.markers_mm if on_clamp is not None and by_frame else self.spheres_mm

    @property
    def on_clamp(self) -> Transform | None:
        """Pose TRACKER <- PATIENT of the frame on the head clamp, None if not seen."""
        return _pose(self.frames.get(Tracked.CLAMP), Frame.PATIENT)

    @property
    def on_arm(self) -> Transform | None:
        """Pose TRACKER <- MARKER of the frame on the arm, None if not seen."""
        return _pose(self.frames.get(Tracked.ARM), Frame.MARKER)

    @property
    def is_careful(self) -> bool:
        """Whether at least `CAREFUL_FRAMES` frames were averaged, as before or after a target."""
        return self.count >= CAREFUL_FRAMES

    def moved_by(self, move: Transform, robot_from_tracker: Transform) -> RoomReading:
        """Return the reading with everything in view moved by TRACKER <- TRACKER.

        `robot_from_tracker` is the pose by which `frame_mm` was computed.
        """
        turn = move.rotation_matrix
        frames = {name: _moved(seen, move) for name, seen in self.frames.items()}
        frame_mm = self.frame_mm
        if frame_mm is not None:
            way_mm = frames[Tracked.ARM].place_mm - self.frames[Tracked.ARM].place_mm
            frame_mm = frame_mm + robot_from_tracker.rotation_matrix @ way_mm
        groups = tuple(
            replace(one, mean_mm=move.apply(one.mean_mm), covariance_mm2=turn @ one.covariance_mm2 @ turn.T)
            for one in self.groups
        )
        markers = move.apply(self.markers_mm) if len(self.markers_mm) else self.markers_mm
        return replace(
            self,
            frame_mm=frame_mm,
            groups=groups,
            markers_mm=markers,
            frames=frames,
            tracker_frames=[seen_after(move, one) for one in self.tracker_frames],
        )

    def sighting(
        self,
        spheres_mm: Array,
        sensors_mm: ArrayLike = SENSORS_MM,
        *,
        tracker: int = 0,
        head: int = 0,
        certain: bool = False,
    ) -> Sighting:
        """Return the sighting that this is, with the spheres (n, 3) of the head identified.

        `sensors_mm` (2, 3) are the tracker's own, in its frame. `tracker` and `head` count the pushes and
        moves that were followed before. If `certain`, no point that may be a ghost counts as a sphere.
        """
        pairs = self._identify(spheres_mm, sensors_mm, 0.0 if certain else LINE_MM)
        seen = SeenSpheres(
            tuple(number for number, _ in pairs),
            np.array([group.mean_mm for _, group in pairs]).reshape(-1, 3),
            np.array(
                [mean_covariance(one.covariance_mm2, one.count - one.outliers) for _, one in pairs]
            ).reshape(-1, 3, 3)
            + self.fitted * FITTED_MM**2 * np.eye(3),
        )
        return Sighting(self.rests, seen, self.frames, tracker, head)

    def _identify(
        self, spheres_mm: Array, sensors_mm: ArrayLike, in_place_mm: float
    ) -> list[tuple[int, StrayGroup]]:
        """Pair known spheres with strays: by their layout, or each with the one at its place.

        What may be a ghost beside the place of a hidden sphere is not that sphere, unless it is within
        `in_place_mm` of that place: there, a sphere is more likely.
        """
        seen_mm = self.spheres_mm
        if not len(spheres_mm):  # a head without markers: strays are reflections and ghosts
            return []
        pairs = identify_points(spheres_mm, seen_mm)
        if pairs is None:
            apart = np.linalg.norm(spheres_mm[:, None] - seen_mm[None], axis=2)
            pairs = [
                (row, int(apart[row].argmin()))
                for row in range(len(spheres_mm))
                if len(seen_mm) and apart[row].min() < NEAR_MM
            ]
        ghosts = find_ghosts(spheres_mm, self.markers_mm, seen_mm, sensors_mm) if len(seen_mm) else ()
        return [
            (row, self.groups[column])
            for row, column in pairs
            if not ghosts[column] or math.dist(seen_mm[column], spheres_mm[row]) < in_place_mm
        ]


def _pose(seen: SeenFrame | None, source: Frame) -> Transform | None:
    return None if seen is None else Transform.from_matrix(Frame.TRACKER, source, seen.pose)


def _moved(seen: SeenFrame, move: Transform) -> SeenFrame:
    turn = np.kron(np.eye(2), move.rotation_matrix)
    return SeenFrame(
        move.apply(seen.place_mm),
        move.rotation_matrix @ seen.rotation,
        turn @ seen.covariance @ turn.T,
        move.apply(seen.markers_mm),
        seen.shares,
    )


def room_reading(
    workcell: Workcell,
    frames: list[TrackerFrame],
    robot_from_tracker: Transform,
    sides: ArrivedSides = AS_KNOWN,
) -> RoomReading:
    """Average tracker frames taken at the arms' current poses into one reading.

    `sides` are those from which the joints of an arm have arrived, by default as the workcell knows.
    """
    least, on_arm = round(LEAST_SHARE * len(frames)), workcell.calibrations.tracker_frame.tool
    rests = _rests(workcell, sides)
    tracked = {ON_ARM[role]: arm.frame for role, arm in workcell.arms.items() if ON_ARM[role] in rests}
    if workcell.patient_frame is not None:
        tracked[Tracked.CLAMP] = workcell.patient_frame
    seen: dict[Tracked, SeenFrame] = {}
    for body, name in tracked.items():
        poses = list_poses(frames, name)
        if len(poses) >= max(1, least):
            markers_mm = np.array(workcell.tracker.markers_mm[name])
            seen[body] = average_frame(poses, markers_mm, marker_shares(frames, name, len(markers_mm)))
    rest = rests[Tracked.ARM]
    by_arm = robot_from_marker(workcell, rest.joints_rad, rest.sides)
    frame_mm = None
    if (arm := seen.get(Tracked.ARM)) is not None:
        frame_mm = robot_from_tracker.apply(arm.place_mm) - by_arm.translation_mm
        markers = [arm.markers_mm]
    else:
        markers = [(robot_from_tracker.inverse() @ by_arm).apply(workcell.tracker.markers_mm[on_arm])]
    for name, places_mm in workcell.tracker.markers_mm.items():  # the guide's make ghosts as well
        other = None if name == on_arm else mean_pose(frames, name, max(1, least))
        if other is not None:
            markers.append(other.apply(places_mm))
    return RoomReading(
        robot_from_flange=workcell.master.flange_pose(rest.joints_rad, rest.sides),
        rests=rests,
        frame_mm=frame_mm,
        groups=average_strays(frames).groups,
        markers_mm=np.vstack(markers),
        frames=seen,
        count=len(frames),
        settled_home=workcell.master.settled_home,
        on_axis=workcell.master.place.is_on_axis,
        fitted=find_frame_name(workcell.tracker.markers_mm) is not None,
        instrument_led=any(arm.leads_instrument for arm in workcell.arms.values()),
        tracker_frames=frames,
    )


def _rests(workcell: Workcell, sides: ArrivedSides) -> dict[Tracked, Rest]:
    """Return how the arms rest, without others than the master that do not tell their joints."""
    rests: dict[Tracked, Rest] = {}
    for role, arm in workcell.arms.items():
        arrived = sides.get(ON_ARM[role])
        try:
            joints_rad = arm.joints_rad()
        except RonnaError:
            if arm is workcell.master:
                raise
            continue  # for the step that moves it to report
        on_sides = arm.rest_sides if arrived is None else tuple(arrived)
        rests[ON_ARM[role]] = Rest(joints_rad, on_sides, arm.history.motions)
    return rests


def find_ghosts(
    spheres_mm: Array, others_mm: Array, seen_mm: Array, sensors_mm: ArrayLike = SENSORS_MM
) -> NDArray[np.bool_]:
    """Flag points (m, 3) where sensor lines to known markers cross, all in the tracker's frame.

    The lines lead to the spheres (n, 3) and to the other markers (k, 3). Two lines to others are held to the
    narrow limit: with the wide one, too much of the room about the head would count as crossings.
    """
    markers, head = np.vstack([spheres_mm, others_mm]), len(spheres_mm)
    limits = np.repeat([LINE_MM, OTHER_LINE_MM], [head, len(others_mm)])
    left, right = (_distance_from_lines_mm(eye, markers, seen_mm) for eye in np.asarray(sensors_mm))
    pairs = (left < limits)[:, :, None] & (right < limits)[:, None, :]  # (m, n + k, n + k)
    pairs[:, head:, head:] = (left[:, head:, None] < LINE_MM) & (right[:, None, head:] < LINE_MM)
    pairs &= ~np.eye(len(markers), dtype=bool)  # both lines to one marker: that is the marker itself
    return np.asarray(pairs.any(axis=(1, 2)))


def _distance_from_lines_mm(eye_mm: Array, markers_mm: Array, points_mm: Array) -> Array:
    """Return the distance of points (m, 3) from the sensor's lines of sight to markers (n, 3).

    Less the uncertainty of the sensor's position.
    """
    ways = markers_mm - eye_mm
    lengths = np.linalg.norm(ways, axis=1)
    beside = points_mm[:, None] - markers_mm
    along = (beside * (ways / lengths[:, None])).sum(axis=2)
    away = np.sqrt(np.maximum((beside**2).sum(axis=2) - along**2, 0.0))
    return np.asarray(away - SENSOR_MM * np.abs(along) / lengths)
