"""While someone works through the guide, it stays where it was held.

The encoders do not see how an arm gives way under a hand; the tracker does, by the frame on the mount: by its
place, and by where its pose has the lower end of the guide, which a turn of the wrist displaces alone. What
the arm's own joints say is compared as well.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from procedures.engine.case_memory import CaseMemory
from procedures.workcell import Workcell
from procedures.workcell.tracker_look import frames_at_rest, mean_pose, robot_from_marker
from ronna_hw.clock import Clock
from ronna_hw.devices.readings import TrackerFrame, Validity
from ronna_hw.frames import Frame, Transform

Array = NDArray[np.float64]

PUSHED_MM = 0.2  # at the guide: ten newtons on the arm that is assumed make 0.13 mm
# In one frame of the tracker, the place of the frame on the mount has a noise of 0.16 mm; the guide's end,
# 160 mm away, one of 0.42 mm, so that less than `END_SEEN_MM` says nothing. More frames take time, of which a
# trajectory in whose pose the head is hidden has ten seconds.
END_SEEN_MM = 0.3
FRAMES = 60
LEAST_FRAMES = 30  # that must show it
BETWEEN_LOOKS_S = 1.0  # theatre time
# Readings of a watch while it lasts, every fourth frame: with half as many for the place, 4 of 100 insertions
# of ten minutes had a warning with nobody near.
PLACE_READINGS = 30
END_READINGS = 150
HIDDEN = ", and clear the line between the tracker and the frame on the arm: it is not seen now"


@dataclass
class GuideAtRest:
    """How the guide was held when it had come to rest.

    `seen_mm` (2, 3) are the frame on the mount and the lower end of the guide, tracker frame, and None where
    the frame is not seen; `end_in_frame_mm` (3,) is that end in the frame on the mount.
    `worked` says that someone is working through it now: else nothing waits for it. `now_mm` is how far it
    was from its place when it was seen last; `looked_s` is the theatre time of the last look, `unseen` says
    that this did not show it.
    """

    trajectory: str
    tool_mm: Array
    end_in_frame_mm: Array
    seen_mm: Array | None
    now_mm: float = 0.0
    worked: bool = False
    looked_s: float = -math.inf
    unseen: bool = False
    _by_frame_mm: float = 0.0  # when it was seen last
    _recent: deque[Array] = field(default_factory=lambda: deque(maxlen=END_READINGS))

    def begin_watch(self) -> None:
        """Readings of an earlier watch say nothing about where it is now."""
        self._recent.clear()

    def take(self, frame: TrackerFrame, tool: str) -> None:
        """Add one reading of a watch: the mean of the last ones is compared."""
        reading = frame.tool(tool)
        if self.seen_mm is None or reading.validity is not Validity.OK:
            return
        self._recent.append(_ends_mm(reading.transform(Frame.TRACKER, Frame.MARKER), self.end_in_frame_mm))
        recent_mm = np.array(self._recent)
        if len(recent_mm) >= PLACE_READINGS:
            place_mm = recent_mm[-PLACE_READINGS:, 0].mean(axis=0)
            end_mm = recent_mm[:, 1].mean(axis=0) if len(recent_mm) == END_READINGS else self.seen_mm[1]
            self._compare(np.array([place_mm, end_mm]))

    def look(self, workcell: Workcell, clock: Clock) -> None:
        """See how far it is from its place now. Raises what the tracker raises."""
        known = self.seen_mm is not None
        seen_mm = _seen_mm(workcell, clock, self.end_in_frame_mm) if known else None
        self._compare(seen_mm, workcell.tool_pose().translation_mm)
        self.looked_s, self.unseen = clock.now_s(), seen_mm is None

    def _compare(self, seen_mm: Array | None, tool_mm: Array | None = None) -> None:
        """By whichever says most; a frame that is hidden now is taken to be where it was seen last."""
        if seen_mm is not None and self.seen_mm is not None:
            place_mm, end_mm = np.linalg.norm(seen_mm - self.seen_mm, axis=1).tolist()
            self._by_frame_mm = max(place_mm, end_mm if end_mm > END_SEEN_MM else 0.0)
        by_joints_mm = 0.0 if tool_mm is None else float(np.linalg.norm(tool_mm - self.tool_mm))
        self.now_mm = max(self._by_frame_mm, by_joints_mm)


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
            f"the guide and the arm{HIDDEN if rest.unseen else ''}"
        )


def guide_at_rest(workcell: Workcell, clock: Clock, trajectory: str) -> GuideAtRest:
    """How it is held now. Raises what the tracker raises."""
    tool = workcell.tool_pose()
    end_mm = tool.apply([0.0, 0.0, -workcell.tools.guide.bore.reach_mm])
    end_in_frame_mm = robot_from_marker(workcell, workcell.joints_rad()).inverse().apply(end_mm)
    seen_mm = _seen_mm(workcell, clock, end_in_frame_mm)
    return GuideAtRest(trajectory, tool.translation_mm, end_in_frame_mm, seen_mm)


def _seen_mm(workcell: Workcell, clock: Clock, end_in_frame_mm: Array) -> Array | None:
    """Means over `FRAMES` (2, 3), tracker frame; None where too few of them show it."""
    frames, _ = frames_at_rest(workcell.tracker, clock, count=FRAMES)
    pose = mean_pose(frames, workcell.calibrations.tracker_frame.tool, LEAST_FRAMES)
    return None if pose is None else _ends_mm(pose, end_in_frame_mm)


def _ends_mm(pose: Transform, end_in_frame_mm: Array) -> Array:
    """The frame on the mount and the guide's end (2, 3), tracker frame, with the frame at that pose."""
    return np.array([pose.translation_mm, pose.apply(end_in_frame_mm)])
