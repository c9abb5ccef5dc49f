"""While someone works through the guide, it stays where it was held.

The encoders do not see how an arm gives way under a hand; the tracker does, by the frame on the mount: by its
place, and by where its pose has the lower end of the guide, which a turn of the wrist displaces alone. A
guide that bears a frame of its own is seen by that too: its seat may give way. What the arm's own joints say
is compared as well.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.engine.context import CaseMemory
from procedures.guards.room_watch import RoomWatch
from procedures.journal.errors import GateFailed
from procedures.workcell import Workcell
from procedures.workcell.tracker_look import frames_at_rest, mean_pose, robot_from_marker
from ronna_hw.clock import Clock
from ronna_hw.devices.readings import TrackerFrame, Validity
from ronna_hw.frames import Frame, Transform
from ronna_hw.text.beyond import beyond

Array = NDArray[np.float64]

PUSHED_MM = 0.2  # at the guide: ten newtons on the arm that is assumed make 0.13 mm
# In one frame of the tracker, the place of the frame on the mount has a noise of 0.16 mm; the guide's end,
# 160 mm away, one of 0.42 mm, so that less than `END_SEEN_MM` says nothing. Frames take time, of which a
# trajectory in whose pose the head is hidden has ten seconds: a short look, and a long one if that says no.
END_SEEN_MM = 0.3
END = 1  # its row among the points
# Of arms of parameter set S with frames as calibrated, 0.25 deg at most; of the arm itself, nothing is seen.
TURNED_RAD = math.radians(0.5)
FRAMES, FRAMES_AT_FIRST = 60, 30  # at least half of which must show it
BETWEEN_LOOKS_S = 1.0  # theatre time
# Readings of a watch while it lasts, every fourth frame: with half as many for the place, 4 of 100 insertions
# of ten minutes had a warning with nobody near.
PLACE_READINGS = 30
END_READINGS = 150
HIDDEN = ", and clear the line between the tracker and the frame on the arm: it is not seen now"


@dataclass
class GuideAtRest:
    """How the guide was held when it had come to rest.

    `seen_mm` (3, 3) are the frame on the mount, the lower end of the guide and the frame on the guide, in the
    tracker's frame: NaN for the last where it is not seen, and None where the first is not. `end_in_frame_mm`
    (3,) is the end in the frame on the mount, `on_guide` the name of the frame on the guide, if it bears one.
    `worked` says that someone is working through it now: else nothing waits for it; `left` that someone was.
    `now_mm` is how far it was from its place when it was seen last; `looked_s` is the theatre time of the
    last look, `unseen` says that this did not show it.
    """

    trajectory: str
    tool_mm: Array
    end_in_frame_mm: Array
    seen_mm: Array | None
    on_guide: str | None = None
    now_mm: float = 0.0
    worked: bool = False
    left: bool = False
    looked_s: float = -math.inf
    unseen: bool = False
    _moved_mm: Array = field(default_factory=lambda: np.zeros(3))  # each of the points, when it was seen last
    _recent: deque[Array] = field(default_factory=lambda: deque(maxlen=END_READINGS))

    def begin_watch(self) -> None:
        """Readings of an earlier watch say nothing about where it is now."""
        self._recent.clear()

    def take(self, frame: TrackerFrame, tool: str) -> None:
        """Add one reading of a watch: the mean of the last ones is compared."""
        reading = frame.tool(tool)
        if self.seen_mm is None or reading.validity is not Validity.OK:
            return
        on_mount = reading.transform(Frame.TRACKER, Frame.MARKER)
        on_guide = None if self.on_guide is None else frame.tool(self.on_guide)
        place_mm = on_guide.position_mm if on_guide and on_guide.validity is Validity.OK else None
        self._recent.append(_points_mm(on_mount, self.end_in_frame_mm, place_mm))
        recent_mm = np.array(self._recent)
        if len(recent_mm) >= PLACE_READINGS:
            now_mm = recent_mm[-PLACE_READINGS:].mean(axis=0)
            now_mm[END] = recent_mm[:, END].mean(axis=0) if len(recent_mm) == END_READINGS else np.nan
            self._compare(now_mm)

    def look(self, workcell: Workcell, clock: Clock) -> None:
        """See how far it is from its place now. Raises what the tracker raises."""
        known = self.seen_mm is not None
        for count in (FRAMES_AT_FIRST, FRAMES):
            seen_mm = _seen(workcell, clock, self.end_in_frame_mm, self.on_guide, count)[1] if known else None
            self._compare(seen_mm, workcell.tool_pose().translation_mm)
            self.looked_s, self.unseen = clock.now_s(), seen_mm is None
            if self.now_mm <= PUSHED_MM or not known:
                break

    def _compare(self, seen_mm: Array | None, tool_mm: Array | None = None) -> None:
        """By whichever says most; a frame that is hidden now is taken to be where it was seen last."""
        if seen_mm is not None and self.seen_mm is not None:
            moved_mm = np.linalg.norm(seen_mm - self.seen_mm, axis=1)
            self._moved_mm = np.where(np.isfinite(moved_mm), moved_mm, self._moved_mm)
        first_mm, end_mm, on_guide_mm = self._moved_mm.tolist()
        by_frames_mm = max(first_mm, end_mm if end_mm > END_SEEN_MM else 0.0, on_guide_mm)
        by_joints_mm = 0.0 if tool_mm is None else float(np.linalg.norm(tool_mm - self.tool_mm))
        self.now_mm = max(by_frames_mm, by_joints_mm)


@dataclass
class GuideStill:
    """Asked at checkpoints while the case remembers a `GuideAtRest` through which someone works."""

    workcell: Workcell
    clock: Clock
    memory: CaseMemory
    name: str = "guide"

    def unmet(self) -> str | None:
        """By how much it is pushed. Raises what the tracker raises."""
        rest = self.memory.find(GuideAtRest)
        if rest is None or not rest.worked:
            return None
        if self.clock.now_s() - rest.looked_s >= BETWEEN_LOOKS_S:
            rest.look(self.workcell, self.clock)
        if rest.now_mm <= PUSHED_MM:
            return None
        return (
            f"pushed or pulled by {rest.now_mm:.2f} mm, limit {PUSHED_MM:g} mm: let go of "
            f"the guide and the arm{HIDDEN if rest.unseen else ''}; if nobody is touching them, they were "
            "touched as the guide came to rest, or its seat has given way: leave, send the arm home, repeat "
            "tool_check"
        )


def guide_at_rest(
    workcell: Workcell, clock: Clock, trajectory: str, room: RoomWatch | None = None
) -> GuideAtRest:
    """How it is held now. Raises PRO-007 for a hand on it already, and what the tracker raises.

    `room` is the watch of the case, by which the tracker knows how the arm has the frame.
    """
    tool = workcell.tool_pose()
    on_guide = frame.tool if (frame := workcell.tools.guide.record.frame) is not None else None
    by_arm = robot_from_marker(workcell, workcell.joints_rad())
    end_in_frame_mm = by_arm.inverse().apply(tool.apply([0.0, 0.0, -workcell.tools.guide.bore.reach_mm]))
    on_mount, seen_mm = _seen(workcell, clock, end_in_frame_mm, on_guide)
    if on_mount is not None and room is not None:
        _require_unturned(by_arm, room.robot_from_tracker @ on_mount)
    return GuideAtRest(
        trajectory, tool.translation_mm, end_in_frame_mm, seen_mm, on_guide, looked_s=clock.now_s()
    )


def _require_unturned(by_arm: Transform, seen: Transform) -> None:
    """Raises PRO-007 when the frame on the mount is turned against where the arm has it."""
    turned_rad = float((by_arm.rigid.rotation.inv() * seen.rigid.rotation).magnitude())
    if turned_rad > TURNED_RAD:
        turned_deg, limit_deg = math.degrees(turned_rad), math.degrees(TURNED_RAD)
        raise GateFailed(
            "the tracker sees the frame on the arm turned against where the arm has it",
            limit=f"{limit_deg:g} deg",
            got=f"{beyond(turned_deg, limit_deg, 2)} deg",
            action="Let go of guide and arm, check that mount and frame are tight, send the arm home, then "
            "repeat the step.",
        )


def _seen(
    workcell: Workcell, clock: Clock, end_in_frame_mm: Array, on_guide: str | None, count: int = FRAMES
) -> tuple[Transform | None, Array | None]:
    """Mean pose of the frame on the mount and `seen_mm`; None where too few frames show it."""
    frames, _ = frames_at_rest(workcell.tracker, clock, count=count)
    on_mount = mean_pose(frames, workcell.calibrations.tracker_frame.tool, count // 2)
    if on_mount is None:
        return None, None
    guide = None if on_guide is None else mean_pose(frames, on_guide, count // 2)
    return on_mount, _points_mm(on_mount, end_in_frame_mm, None if guide is None else guide.translation_mm)


def _points_mm(on_mount: Transform, end_in_frame_mm: Array, on_guide_mm: ArrayLike | None) -> Array:
    """The frame on the mount, the guide's end and the frame on the guide (3, 3), tracker frame."""
    guide_mm = np.full(3, np.nan) if on_guide_mm is None else np.asarray(on_guide_mm, dtype=float)
    return np.array([on_mount.translation_mm, on_mount.apply(end_in_frame_mm), guide_mm])
