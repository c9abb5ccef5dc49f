"""While someone works through the guide, it stays where it was held.

The encoders do not see how an arm gives way under a hand; the tracker does, by the frame on the mount. What
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
from procedures.workcell.tracker_look import frames_at_rest, mean_pose
from ronna_hw.clock import Clock
from ronna_hw.devices.readings import TrackerFrame, Validity

Array = NDArray[np.float64]

PUSHED_MM = 0.2  # at the guide: ten newtons on the arm that is assumed make 0.13 mm
# The place of the frame on the mount has a noise of 0.06 mm across the line of sight and 0.13 mm along it in
# one frame; undisturbed, the largest of four such means is 0.02 to 0.11 mm beside the first.
FRAMES = 30
LEAST_FRAMES = 15  # that must show it
BETWEEN_LOOKS_S = 1.0  # theatre time
# Readings of a watch while it lasts, every fourth frame: with half as many, 4 of 100 insertions of ten
# minutes had a warning with nobody near.
RUNNING_FRAMES = 30
HIDDEN = ", and clear the line between the tracker and the frame on the arm: it is not seen now"


@dataclass
class GuideAtRest:
    """How the guide was held when it had come to rest.

    `frame_mm` (3,) is the place of the frame on the mount, tracker frame, and None where it is not seen.
    `worked` says that someone is working through it now: else nothing waits for it. `now_mm` is how far it
    was from its place when it was seen last; `looked_s` is the theatre time of the last look, `unseen` says
    that this did not show it.
    """

    trajectory: str
    tool_mm: Array
    frame_mm: Array | None
    now_mm: float = 0.0
    worked: bool = False
    looked_s: float = -math.inf
    unseen: bool = False
    _seen_mm: float = 0.0  # by the frame on the mount, when it was seen last
    _recent: deque[Array] = field(default_factory=lambda: deque(maxlen=RUNNING_FRAMES))

    def begin_watch(self) -> None:
        """Readings of an earlier watch say nothing about where it is now."""
        self._recent.clear()

    def take(self, frame: TrackerFrame, tool: str) -> None:
        """Add one reading of a watch: the mean of the last ones is compared."""
        if self.frame_mm is None:
            return
        seen = frame.tool(tool)
        if seen.validity is Validity.OK and seen.position_mm is not None:
            self._recent.append(np.asarray(seen.position_mm, dtype=float))
        if len(self._recent) == RUNNING_FRAMES:
            self._compare(np.mean(self._recent, axis=0))

    def look(self, workcell: Workcell, clock: Clock) -> None:
        """See how far it is from its place now. Raises what the tracker raises."""
        frame_mm = None if self.frame_mm is None else frame_place_mm(workcell, clock)
        self._compare(frame_mm, workcell.tool_pose().translation_mm)
        self.looked_s, self.unseen = clock.now_s(), frame_mm is None

    def _compare(self, frame_mm: Array | None, tool_mm: Array | None = None) -> None:
        """By whichever says more; a frame that is hidden now is taken to be where it was seen last."""
        if frame_mm is not None and self.frame_mm is not None:
            self._seen_mm = float(np.linalg.norm(frame_mm - self.frame_mm))
        by_joints_mm = 0.0 if tool_mm is None else float(np.linalg.norm(tool_mm - self.tool_mm))
        self.now_mm = max(self._seen_mm, by_joints_mm)


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
    return GuideAtRest(trajectory, workcell.tool_pose().translation_mm, frame_place_mm(workcell, clock))


def frame_place_mm(workcell: Workcell, clock: Clock) -> Array | None:
    """The mean place of the frame on the mount (3,), tracker frame; None where too few frames show it."""
    frames, _ = frames_at_rest(workcell.tracker, clock, count=FRAMES)
    pose = mean_pose(frames, workcell.calibrations.tracker_frame.tool, LEAST_FRAMES)
    return None if pose is None else np.asarray(pose.translation_mm, dtype=float)
