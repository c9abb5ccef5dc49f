"""Tracker reading of the frame on the arm and all spheres, with the arm at rest.

Some of the spheres are ghosts, where the lines of sight to two different markers cross. Each of the tracker's
two sensors knows a marker only as a line. Two markers in one plane with both sensors produce, besides their
own places, up to two crossings without any marker. A marker seen by one sensor alone is not reported and yet
takes part, so a half hidden head shows points at no known position. A ghost is on one sensor's line to one
marker and on the other sensor's line to another.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.guards.stability import CAREFUL_FRAMES, HEAD_NOTICEABLE_MM
from procedures.planning.tracker_sight import SENSORS_MM
from procedures.workcell import Workcell
from procedures.workcell.patient_frame import as_patient
from procedures.workcell.tracker_look import mean_pose, read_frames_at_rest, robot_from_marker
from ronna_hw.clock import Clock
from ronna_hw.devices.readings import TrackerFrame
from ronna_hw.devices.strays import LEAST_SHARE, average_strays
from ronna_hw.frames import Transform

Array = NDArray[np.float64]

# Rms of the spheres on the head in a reading of `FRAMES`: between the noise, 0.10 mm at most in 600 readings,
# and the 0.5 mm that must be noticed.
PATIENT_LIMIT_MM = 0.3
FRAMES = 12  # 0.2 s: noise of 0.02 mm for the frame on the arm, 0.05 mm for a sphere
LINE_MM = 1.0  # from a line: the tracker's bias differs between places by some tenths
OTHER_LINE_MM = 4.0  # to a marker on the arm, perhaps located by the arm alone: its mount is off by 3.5 mm
SENSOR_MM = 10.0  # uncertainty of the sensors' positions; matters in proportion to the way along the line


@dataclass(frozen=True)
class RoomReading:
    """Mean of `frames` tracker frames with the arm at rest.

    `robot_from_flange` is the arm's pose, by its calibration if there is one. `frame_mm` (3,) is the frame on
    the arm by the tracker minus that by the arm, robot frame; None while it is not seen. In the tracker's
    frame, `spheres_mm` (m, 3) are strays, `markers_mm` (k, 3) the markers of the frame and of other tools in
    view. `settled` says that the arm is at home, every joint having arrived from its usual side.
    `robot_from_tracker` is by this reading of the frame alone. `arm_frame_mm` (3,) and `on_clamp`
    (TRACKER <- PATIENT) are the frame on the arm and the patient's frame as the tracker sees them, None if
    not seen or not there.
    """

    robot_from_flange: Transform
    frame_mm: Array | None
    spheres_mm: Array
    markers_mm: Array = field(default_factory=lambda: np.empty((0, 3)))
    frames: int = 1
    settled: bool = False
    robot_from_tracker: Transform | None = None
    arm_frame_mm: Array | None = None
    on_clamp: Transform | None = None

    def moved_by(self, move: Transform, robot_from_tracker: Transform) -> RoomReading:
        """Return the reading with everything in view moved by TRACKER <- TRACKER.

        `robot_from_tracker` is the pose by which `frame_mm` was computed.
        """
        frame_mm, arm_frame_mm = self.frame_mm, self.arm_frame_mm
        if frame_mm is not None and arm_frame_mm is not None:
            way_mm = move.apply(arm_frame_mm) - arm_frame_mm
            frame_mm = frame_mm + robot_from_tracker.rotation_matrix @ way_mm
            arm_frame_mm = arm_frame_mm + way_mm
        by_frame = self.robot_from_tracker
        return replace(
            self,
            frame_mm=frame_mm,
            arm_frame_mm=arm_frame_mm,
            spheres_mm=move.apply(self.spheres_mm) if len(self.spheres_mm) else self.spheres_mm,
            markers_mm=move.apply(self.markers_mm) if len(self.markers_mm) else self.markers_mm,
            robot_from_tracker=None if by_frame is None else by_frame @ move.inverse(),
            on_clamp=None if self.on_clamp is None else move @ self.on_clamp,
        )

    @property
    def is_careful(self) -> bool:
        """Whether at least `CAREFUL_FRAMES` frames were averaged, as before or after a target."""
        return self.frames >= CAREFUL_FRAMES

    @property
    def is_comparable(self) -> bool:
        """Whether the frame on the arm differs only by noise from other such readings of the same pose."""
        return self.is_careful and self.settled

    @property
    def head_limit_mm(self) -> float:
        """Smallest rms displacement of the spheres that counts as a moved head."""
        return HEAD_NOTICEABLE_MM if self.is_careful else PATIENT_LIMIT_MM


def read_room(
    workcell: Workcell, clock: Clock, robot_from_tracker: Transform, count: int = FRAMES
) -> RoomReading:
    """Read tracker frames with the arm at rest. Raises the tracker's errors."""
    frames, _ = read_frames_at_rest(workcell.tracker, clock, count=count)
    return room_reading(workcell, frames, robot_from_tracker)


def room_reading(
    workcell: Workcell, frames: list[TrackerFrame], robot_from_tracker: Transform
) -> RoomReading:
    """Average tracker frames taken at the arm's current pose into one reading."""
    groups = average_strays(frames).groups
    spheres = np.array([group.mean_mm for group in groups]).reshape(-1, 3)
    least, on_arm = round(LEAST_SHARE * len(frames)), workcell.calibrations.tracker_frame.tool
    seen = mean_pose(frames, on_arm, least)
    joints = workcell.joints_rad()
    by_arm = robot_from_marker(workcell, joints)
    frame_mm = None
    if seen is not None:
        frame_mm = (robot_from_tracker @ seen).translation_mm - by_arm.translation_mm
    frame = robot_from_tracker.inverse() @ by_arm if seen is None else seen
    markers = [frame.apply(workcell.tracker.markers_mm[on_arm])]
    for name, places_mm in workcell.tracker.markers_mm.items():  # the guide's make ghosts as well
        other = None if name == on_arm else mean_pose(frames, name, least)
        if other is not None:
            markers.append(other.apply(places_mm))
    clamp = None if workcell.patient_frame is None else mean_pose(frames, workcell.patient_frame, least)
    return RoomReading(
        workcell.flange_pose(joints),
        frame_mm,
        spheres,
        np.vstack(markers),
        len(frames),
        workcell.settled_home,
        None if seen is None else by_arm @ seen.inverse(),
        None if seen is None else seen.translation_mm,
        None if clamp is None else as_patient(clamp),
    )


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
