"""Displacement of the guide while somebody works through it.

Encoders do not see an arm give way under a hand. The tracker does, by the place of the frame on the mount
and, as its seat may give way, of a frame on the guide. Where that is not seen, the lower end of the guide by
the pose of the mount stands in: a turn of the wrist alone displaces it. The joints are compared as well.

A pushed tracker sees the guide displaced as well. With the patient's frame in the theatre it is followed
before the guide counts as pushed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.engine.setting import CaseMemory
from procedures.guards.room_watch import RoomWatch
from procedures.workcell import Workcell
from procedures.workcell.tracker_look import mean_pose, read_frames_at_rest, robot_from_marker
from ronna_hw.clock import Clock
from ronna_hw.devices.readings import TrackerFrame, Validity
from ronna_hw.frames import Frame, Transform

Array = NDArray[np.float64]

PUSHED_MM = 0.2  # at the guide: ten newtons on the arm that is assumed make 0.13 mm
# In one frame of the tracker, the place of the frame on the mount has a noise of 0.16 mm, the guide's end,
# 160 mm away, one of 0.42 mm: less than `END_SEEN_MM` means nothing. Frames take time, and a trajectory in
# whose pose the head is hidden has ten seconds: hence a short look, and a long one only if that shows a push.
END_SEEN_MM = 0.3
END, ON_GUIDE = 1, 2  # rows of the guide's end and of the frame on the guide among the points
FRAMES, FRAMES_AT_FIRST = 60, 30  # at least half must show the frame
BETWEEN_LOOKS_S = 1.0  # theatre time
# Readings averaged by a watch, every fourth frame: with half as many for the place, 4 of 100 insertions of
# ten minutes had a warning with nobody near.
PLACE_READINGS = 30
END_READINGS = 150
HIDDEN = ", and clear the line between the tracker and the frame on the arm: it is not seen now"


@dataclass
class GuideAtRest:
    """Rest position of the guide, and its displacement since.

    `seen_mm` (3, 3) are the frame on the mount, the lower end of the guide and the frame on the guide, in the
    frame of the tracker at the localization: NaN for the last if not seen, None if the first is not.
    `end_in_frame_mm` (3,) is the end in the frame on the mount; `on_guide` names the frame on the guide, if
    any.
    `is_worked_through`: somebody works through it now; `was_worked_through`: somebody did.
    `now_mm` is its last known displacement, `looked_s` the theatre time of the last look; `unseen` says that
    this look did not show the frame. `find` records a tracker that was followed.
    """

    trajectory: str
    tool_mm: Array
    end_in_frame_mm: Array
    seen_mm: Array | None
    on_guide: str | None = None
    now_mm: float = 0.0
    is_worked_through: bool = False
    was_worked_through: bool = False
    looked_s: float = -math.inf
    unseen: bool = False
    find: Callable[[str], None] = lambda _text: None
    _point_shifts_mm: Array = field(default_factory=lambda: np.zeros(3))  # of each point, when last seen
    _recent: deque[Array] = field(default_factory=lambda: deque(maxlen=END_READINGS))

    def begin_watch(self) -> None:
        """Discard the readings of an earlier watch."""
        self._recent.clear()

    def add_frame(self, frame: TrackerFrame, tool: str) -> None:
        """Add a tracker frame and compare the mean of the latest frames with the rest position."""
        reading = frame.tool(tool)
        if self.seen_mm is None or reading.validity is not Validity.OK:
            return
        is_on_mount = reading.transform(Frame.TRACKER, Frame.MARKER)
        on_guide = None if self.on_guide is None else frame.tool(self.on_guide)
        place_mm = on_guide.position_mm if on_guide and on_guide.validity is Validity.OK else None
        self._recent.append(_points_mm(is_on_mount, self.end_in_frame_mm, place_mm))
        recent_mm = np.array(self._recent)
        if len(recent_mm) >= PLACE_READINGS:
            now_mm = _mean_of_seen_mm(recent_mm[-PLACE_READINGS:])
            now_mm[END] = recent_mm[:, END].mean(axis=0) if len(recent_mm) == END_READINGS else np.nan
            self._compare(now_mm)

    def look(self, workcell: Workcell, clock: Clock, room: RoomWatch | None) -> None:
        """Measure the displacement now. Raises the tracker's errors.

        `room` is the watch of the case. A push of the tracker alone that it shows is followed.
        """
        known = self.seen_mm is not None
        for count in (FRAMES_AT_FIRST, FRAMES):
            frames = read_frames_at_rest(workcell.tracker, clock, count=count)[0] if known else []
            self._measure(workcell, frames, room)
            self.looked_s = clock.now_s()
            if self.now_mm <= PUSHED_MM or not known:
                return
        if room is None:
            return
        _, followed = room.follow_tracker(room.judge(room.read(workcell, frames)))
        if followed:
            for finding in followed:
                self.find(f"at {self.trajectory}: {finding}")
            self._measure(workcell, frames, room)

    def _measure(self, workcell: Workcell, frames: list[TrackerFrame], room: RoomWatch | None) -> None:
        """Compare the guide in these frames, and the arm's joints, with the rest position."""
        seen_mm = _measure_frame(workcell, frames, room, self.end_in_frame_mm, self.on_guide)
        self._compare(seen_mm, workcell.master.tool_pose().translation_mm)
        self.unseen = seen_mm is None

    def _compare(self, seen_mm: Array | None, tool_mm: Array | None = None) -> None:
        """Update the displacement from its largest estimate. Hidden points keep their last displacement."""
        if seen_mm is not None and self.seen_mm is not None:
            moved_mm = np.linalg.norm(seen_mm - self.seen_mm, axis=1)
            self._point_shifts_mm = np.where(np.isfinite(moved_mm), moved_mm, self._point_shifts_mm)
        first_mm, end_mm, on_guide_mm = self._point_shifts_mm.tolist()
        # A marker of the mount that is hidden now and was not before turns it by milliradians.
        stands_in = end_mm > END_SEEN_MM and (seen_mm is None or not np.isfinite(seen_mm[ON_GUIDE]).all())
        by_frames_mm = max(first_mm, end_mm if stands_in else 0.0, on_guide_mm)
        by_joints_mm = 0.0 if tool_mm is None else float(np.linalg.norm(tool_mm - self.tool_mm))
        self.now_mm = max(by_frames_mm, by_joints_mm)


@dataclass
class GuideDisplacement:
    """Guard for guide displacement while someone works through the guide."""

    workcell: Workcell
    clock: Clock
    memory: CaseMemory
    name: str = "guide"

    def unmet(self) -> str | None:
        """Describe an excessive guide displacement. Raises the tracker's errors."""
        rest = self.memory.find(GuideAtRest)
        if rest is None or not rest.is_worked_through:
            return None
        if self.clock.now_s() - rest.looked_s >= BETWEEN_LOOKS_S:
            rest.look(self.workcell, self.clock, self.memory.find(RoomWatch))
        if rest.now_mm <= PUSHED_MM:
            return None
        return (
            f"pushed or pulled by {rest.now_mm:.2f} mm, limit {PUSHED_MM:g} mm: let go of "
            f"the guide and the arm{HIDDEN if rest.unseen else ''}; if nobody is touching them, the cart or "
            "the tracker was moved, they were touched as the guide came to rest, or its seat has given way: "
            "leave, send the arm home, repeat tool_check"
        )


def measure_guide_at_rest(
    workcell: Workcell,
    clock: Clock,
    trajectory: str,
    frames: Sequence[TrackerFrame] | None = None,
    find: Callable[[str], None] = lambda _text: None,
) -> GuideAtRest:
    """Measure the guide's rest position. Raises the tracker's errors.

    Whether the guide is already pushed is for the look at the room to say. `frames` are those of that look,
    as from where the tracker was localized; without them, it is read anew. `find` records a finding.
    """
    tool = workcell.master.tool_pose()
    on_guide = frame.tool if (frame := workcell.tools.guide.record.frame) is not None else None
    by_arm = robot_from_marker(workcell, workcell.master.joints_rad())
    end_in_frame_mm = by_arm.inverse().apply(tool.apply([0.0, 0.0, -workcell.tools.guide.bore.reach_mm]))
    if frames is None:
        frames, _ = read_frames_at_rest(workcell.tracker, clock, count=FRAMES)
    seen_mm = _measure_frame(workcell, list(frames), None, end_in_frame_mm, on_guide)
    return GuideAtRest(
        trajectory, tool.translation_mm, end_in_frame_mm, seen_mm, on_guide, looked_s=clock.now_s(), find=find
    )


def _measure_frame(
    workcell: Workcell,
    frames: list[TrackerFrame],
    room: RoomWatch | None,
    end_in_frame_mm: Array,
    on_guide: str | None,
) -> Array | None:
    """Return `seen_mm`, or None if the frame on the mount is rarely seen."""
    if room is not None:
        frames = [room.as_localized(frame) for frame in frames]
    least = max(1, len(frames) // 2)
    is_on_mount = mean_pose(frames, workcell.calibrations.tracker_frame.tool, least)
    if is_on_mount is None:
        return None
    guide = None if on_guide is None else mean_pose(frames, on_guide, least)
    return _points_mm(is_on_mount, end_in_frame_mm, None if guide is None else guide.translation_mm)


def _mean_of_seen_mm(readings_mm: Array) -> Array:
    """Average each point (3, 3) over readings (n, 3, 3). NaN if seen in fewer than half."""
    is_seen: NDArray[np.bool_] = np.asarray(np.isfinite(readings_mm).all(axis=2))
    counts = is_seen.sum(axis=0)[:, np.newaxis]
    sums_mm = np.where(is_seen[..., np.newaxis], readings_mm, 0.0).sum(axis=0)
    means_mm: Array = np.where(2 * counts >= len(readings_mm), sums_mm / np.maximum(counts, 1), np.nan)
    return means_mm


def _points_mm(is_on_mount: Transform, end_in_frame_mm: Array, on_guide_mm: ArrayLike | None) -> Array:
    """Return mount frame, guide end and guide frame as points (3, 3) mm in the tracker frame."""
    guide_mm = np.full(3, np.nan) if on_guide_mm is None else np.asarray(on_guide_mm, dtype=float)
    return np.array([is_on_mount.translation_mm, is_on_mount.apply(end_in_frame_mm), guide_mm])
