"""Displacement of the guide while somebody works through it.

Encoders do not see an arm give way under a hand. The tracker does, by the place of the frame on the mount
and, as its seat may give way, of a frame on the guide; each also while the other is hidden. Where the frame
on the guide is not seen, the lower end of the guide by the pose of the mount stands in: a turn of the wrist
alone displaces it. The joints are compared as well. What is not seen at the moment that counts is told: a
displacement that has gone back by the next look leaves no trace.

A pushed tracker sees the guide displaced as well. With the patient's frame in the theatre it is followed
before the guide counts as pushed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from procedures.engine.setting import CaseMemory
from procedures.guards.room_watch import RoomWatch
from procedures.workcell import Workcell
from procedures.workcell.tracker_look import mean_pose, read_frames_at_rest, robot_from_marker
from ronna_hw.arrays import Array
from ronna_hw.devices.readings import TrackerFrame, Validity
from ronna_hw.frames import Frame, Transform

# Safety against a guide that is pushed aside (U).
PUSHED_MM = 0.2  # at the guide: ten newtons on the arm that is assumed make 0.13 mm
# In one frame of the tracker, the place of the frame on the mount has a noise of 0.16 mm, the guide's end,
# 160 mm away, one of 0.42 mm: less than `END_SEEN_MM` means nothing. Frames take time, and a trajectory in
# whose pose the head is hidden has ten seconds: hence a short look, and a long one only if that shows a push.
# Safety against a guide that is pushed aside. Source: the tracker's noise.
END_SEEN_MM = 0.3

MOUNT, END, ON_GUIDE = 0, 1, 2  # rows of both frames and of the guide's end among the points
HEAD_NAME, FRAME_NAMES = "the head", {MOUNT: "the frame on the arm", ON_GUIDE: "the frame on the guide"}
# Safety against a guide that nobody sees.
LONGEST_GUIDE_UNSEEN_S = 1.0  # theatre time; a hand that leans on something does so for longer (U)

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
    frame of the tracker at the localization; NaN where not seen.
    `end_in_frame_mm` (3,) is the end in the frame on the mount; `on_guide` names the frame on the guide, if
    any.
    `is_worked_through`: somebody works through it now; `was_worked_through`: somebody did.
    `now_mm` is its last known displacement, `looked_s` the theatre time of the last look; `hidden` are the
    frames, known at rest, that this look did not show. `unseen_s` is for how long at most the work went on
    with something out of sight, by its name; `missed` is what a watch did not see at all.
    `find` records a tracker that was followed.
    """

    trajectory: str
    tool_mm: Array
    end_in_frame_mm: Array
    seen_mm: Array
    on_guide: str | None = None
    now_mm: float = 0.0
    is_worked_through: bool = False
    was_worked_through: bool = False
    looked_s: float = -math.inf
    hidden: tuple[int, ...] = ()
    unseen_s: dict[str, float] = field(default_factory=dict)
    missed: set[str] = field(default_factory=set)
    find: Callable[[str], None] = lambda _text: None
    _point_shifts_mm: Array = field(default_factory=lambda: np.zeros(3))  # of each point, when last seen
    _recent: Mapping[int, deque[Array]] = field(
        default_factory=lambda: {
            MOUNT: deque(maxlen=PLACE_READINGS),
            END: deque(maxlen=END_READINGS),
            ON_GUIDE: deque(maxlen=PLACE_READINGS),
        }
    )
    _last_seen_s: dict[int, float] = field(default_factory=dict)
    _seen_in_watch: set[int] = field(default_factory=set)

    @property
    def known(self) -> tuple[int, ...]:
        """Frames that were seen with the guide at rest."""
        return tuple(row for row in FRAME_NAMES if np.isfinite(self.seen_mm[row]).all())

    @property
    def is_unseen(self) -> bool:
        """Whether the last look showed no frame: only the joints show a push."""
        return len(self.hidden) == len(self.known)

    def begin_watch(self, now_s: float) -> None:
        """Discard the readings of an earlier watch."""
        for readings in self._recent.values():
            readings.clear()
        self._last_seen_s = dict.fromkeys(self.known, now_s)
        self._seen_in_watch = set()

    def end_watch(self, now_s: float, head_unseen_s: float, *, head_seen: bool) -> None:
        """Note what this watch did not see, and for how long at most it did not see the head."""
        for row, since_s in self._last_seen_s.items():
            self._note_unseen(FRAME_NAMES[row], now_s - since_s, seen=row in self._seen_in_watch)
        self._note_unseen(HEAD_NAME, head_unseen_s, seen=head_seen)

    def _note_unseen(self, name: str, for_s: float, *, seen: bool) -> None:
        if self.is_worked_through:
            self.unseen_s[name] = max(for_s, self.unseen_s.get(name, 0.0))
            self.missed |= set() if seen else {name}

    def describe_unseen(self) -> str:
        """Name what was out of sight during the work, throughout a stage or for too long, or return ''."""
        return ", ".join(
            name if for_s <= LONGEST_GUIDE_UNSEEN_S else f"{name} for {for_s:.0f} s"
            for name, for_s in self.unseen_s.items()
            if name in self.missed or for_s > LONGEST_GUIDE_UNSEEN_S
        )

    def add_frame(self, frame: TrackerFrame, tool: str, now_s: float) -> None:
        """Add a tracker frame and compare the mean of the latest frames with the rest position."""
        mount, guide = (None if name is None else frame.tool(name) for name in (tool, self.on_guide))
        is_on_mount = guide_mm = None
        if mount is not None and mount.validity is Validity.OK:
            is_on_mount = mount.transform(Frame.TRACKER, Frame.MARKER)
        if guide is not None and guide.validity is Validity.OK:
            guide_mm = guide.position_mm
        points_mm = _points_mm(is_on_mount, self.end_in_frame_mm, guide_mm)
        for row, since_s in self._last_seen_s.items():
            if np.isfinite(points_mm[row]).all():
                self._note_unseen(FRAME_NAMES[row], now_s - since_s, seen=True)
                self._last_seen_s[row] = now_s
                self._seen_in_watch.add(row)
        now_mm = np.full((3, 3), np.nan)
        for row, readings in self._recent.items():
            if np.isfinite(points_mm[row]).all():
                readings.append(points_mm[row])
                if len(readings) == readings.maxlen:
                    now_mm[row] = np.mean(readings, axis=0)
        if np.isfinite(now_mm).any():
            self._compare(now_mm)

    def look(self, workcell: Workcell, room: RoomWatch | None) -> None:
        """Measure the displacement now. Raises the tracker's errors.

        `room` is the watch of the case. A push of the tracker alone that it shows is followed.
        """
        known = bool(self.known)
        for count in (FRAMES_AT_FIRST, FRAMES):
            frames = read_frames_at_rest(workcell, count=count)[0] if known else []
            self._measure(workcell, frames, room)
            self.looked_s = workcell.clock.now_s()
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
        self.hidden = tuple(row for row in self.known if not np.isfinite(seen_mm[row]).all())

    def _compare(self, seen_mm: Array, tool_mm: Array | None = None) -> None:
        """Update the displacement from its largest estimate. Hidden points keep their last displacement."""
        moved_mm = np.linalg.norm(seen_mm - self.seen_mm, axis=1)
        self._point_shifts_mm = np.where(np.isfinite(moved_mm), moved_mm, self._point_shifts_mm)
        first_mm, end_mm, on_guide_mm = self._point_shifts_mm.tolist()
        # A marker of the mount that is hidden now and was not before turns it by milliradians.
        stands_in = end_mm > END_SEEN_MM and not np.isfinite(seen_mm[ON_GUIDE]).all()
        by_frames_mm = max(first_mm, end_mm if stands_in else 0.0, on_guide_mm)
        by_joints_mm = 0.0 if tool_mm is None else float(np.linalg.norm(tool_mm - self.tool_mm))
        self.now_mm = max(by_frames_mm, by_joints_mm)


@dataclass
class GuideDisplacement:
    """Guard for guide displacement while someone works through the guide."""

    workcell: Workcell
    memory: CaseMemory
    name: str = "guide"

    def unmet(self) -> str | None:
        """Describe an excessive guide displacement. Raises the tracker's errors."""
        rest = self.memory.find(GuideAtRest)
        if rest is None or not rest.is_worked_through:
            return None
        if self.workcell.clock.now_s() - rest.looked_s >= BETWEEN_LOOKS_S:
            rest.look(self.workcell, self.memory.find(RoomWatch))
        if rest.now_mm <= PUSHED_MM:
            return None
        return (
            f"pushed or pulled by {rest.now_mm:.2f} mm, limit {PUSHED_MM:g} mm: let go of the guide and "
            f"the arm{HIDDEN if rest.is_unseen else ''}; if nobody is touching them, the cart or the tracker "
            "was moved, they were touched as the guide came to rest, or its seat has given way: "
            "leave, send the arm home, repeat tool_check"
        )


def measure_guide_at_rest(
    workcell: Workcell,
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
        frames, _ = read_frames_at_rest(workcell, count=FRAMES)
    seen_mm = _measure_frame(workcell, list(frames), None, end_in_frame_mm, on_guide)
    now_s = workcell.clock.now_s()
    return GuideAtRest(
        trajectory, tool.translation_mm, end_in_frame_mm, seen_mm, on_guide, looked_s=now_s, find=find
    )


def _measure_frame(
    workcell: Workcell,
    frames: list[TrackerFrame],
    room: RoomWatch | None,
    end_in_frame_mm: Array,
    on_guide: str | None,
) -> Array:
    """Return `seen_mm`, NaN for what is rarely seen."""
    if room is not None:
        frames = [room.as_localized(frame) for frame in frames]
    least = max(1, len(frames) // 2)
    is_on_mount = mean_pose(frames, workcell.calibrations.tracker_frame.tool, least)
    guide = None if on_guide is None else mean_pose(frames, on_guide, least)
    return _points_mm(is_on_mount, end_in_frame_mm, None if guide is None else guide.translation_mm)


def _points_mm(is_on_mount: Transform | None, end_in_frame_mm: Array, on_guide_mm: ArrayLike | None) -> Array:
    """Return mount frame, guide end and guide frame as points (3, 3) mm in the tracker frame, or NaN."""
    points_mm = np.full((3, 3), np.nan)
    if is_on_mount is not None:
        points_mm[MOUNT], points_mm[END] = is_on_mount.translation_mm, is_on_mount.apply(end_in_frame_mm)
    if on_guide_mm is not None:
        points_mm[ON_GUIDE] = on_guide_mm
    return points_mm
