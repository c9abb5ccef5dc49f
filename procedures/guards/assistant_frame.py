"""Displacement of the assistant against its frame while it leads an instrument through the guide, or out."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronna_hw.devices.readings import TrackerFrame, Validity

if TYPE_CHECKING:
    from procedures.workcell.assistant import Assistant
    from ronna_hw.frames import Transform
    from ronna_hw.vectors import JointVector

Array = NDArray[np.float64]

READINGS = 15  # averaged: 0.06 mm of noise, at 0.25 mm in one frame
# Across the axis: over the way of an instrument the tracker's own error changes by 0.3 mm.
SHIFTED_MM = 0.8


@dataclass
class AssistantFrame:
    """Way of the assistant's frame beside its joints since the tracker was last looked at over the guide.

    Without that look, since the motion along the axis began. Only across the axis: along it the joints are
    read some milliseconds after the frame, and the arm moves. The flange does not turn on that way, so its
    own position stands for that of the frame on it.
    """

    assistant: Assistant
    shifted_mm: float = 0.0
    _first_mm: Array | None = None
    _recent_mm: deque[Array] = field(default_factory=lambda: deque(maxlen=READINGS))

    @property
    def has_seen(self) -> bool:
        """Whether this watch has seen enough of the frame to compare it."""
        return len(self._recent_mm) == READINGS

    @property
    def is_referenced(self) -> bool:
        """Reference place known, from which the way is counted."""
        return self._first_mm is not None

    def begin_watch(self) -> None:
        """Discard what an earlier watch has seen, but for where it counts from."""
        self.shifted_mm = 0.0
        self._recent_mm.clear()

    def begin_at(self, seen_mm: ArrayLike, robot_from_tracker: Transform) -> None:
        """Count from where the frame is seen now, with the assistant at rest."""
        if (known := self.assistant.arm.observe().reading) is not None:
            self._first_mm = self._beside_joints_mm(seen_mm, known.joints_rad, robot_from_tracker)

    def _beside_joints_mm(
        self, seen_mm: ArrayLike, joints_rad: JointVector, robot_from_tracker: Transform
    ) -> Array:
        flange = self.assistant.calibrated.forward(joints_rad)
        return robot_from_tracker.apply(seen_mm) - self.assistant.base.apply(flange.position_mm)

    def add_frame(self, frame: TrackerFrame, robot_from_tracker: Transform) -> None:
        """Add a tracker frame; one that does not show the assistant, or off the axis, tells nothing."""
        assistant = self.assistant
        axis, known = assistant.place.axis, assistant.arm.observe().reading
        reading = frame.tool(assistant.holder.frame)
        seen_mm = reading.position_mm if reading.validity is Validity.OK else None
        if seen_mm is None or axis is None or known is None:
            return
        self._recent_mm.append(self._beside_joints_mm(seen_mm, known.joints_rad, robot_from_tracker))
        if len(self._recent_mm) < READINGS:
            return
        mean_mm = np.mean(self._recent_mm, axis=0)
        if self._first_mm is None:
            self._first_mm = mean_mm
        along = assistant.base.rotation_matrix @ axis.held.rotation_matrix[:, 2]
        self.shifted_mm = float(np.linalg.norm(np.cross(along, mean_mm - self._first_mm)))
