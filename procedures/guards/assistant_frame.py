"""Displacement of the assistant against its frame while it leads an instrument through the guide, or out.

What counts is where its clamp is, which holds the instrument: a cart that turns about the frame leaves the
frame in its place and leads the clamp away.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from ronna_hw.devices.readings import TrackerFrame, Validity
from ronna_hw.frames import Frame, Transform

if TYPE_CHECKING:
    from procedures.workcell.assistant import Assistant
    from ronna_hw.vectors import JointVector

Array = NDArray[np.float64]

READINGS = 15  # averaged: 0.06 mm of noise at the frame, 0.15 at the clamp; at 0.25 mm in one frame
# Across the axis: over the way of an instrument the tracker's own error changes by 0.3 mm.
SHIFTED_MM = 0.8


@dataclass
class AssistantFrame:
    """Way of the assistant's clamp beside its joints since the tracker was last looked at over the guide.

    Without that look, since the motion along the axis began. Only across the axis: along it the joints are
    read some milliseconds after the frame, and the arm moves.
    """

    assistant: Assistant
    shifted_mm: float = 0.0
    _flange_from_frame: RigidTransform | None = None  # as first seen
    _recent: deque[tuple[RigidTransform, RigidTransform]] = field(
        default_factory=lambda: deque(maxlen=READINGS)
    )  # flange by the joints and frame by the tracker, robot frame

    @property
    def has_seen(self) -> bool:
        """Whether this watch has seen enough of the frame to compare it."""
        return len(self._recent) == READINGS

    @property
    def is_referenced(self) -> bool:
        """Whether there is a reference from which the way is counted."""
        return self._flange_from_frame is not None

    def begin_watch(self) -> None:
        """Discard what an earlier watch has seen, but for where it counts from."""
        self.shifted_mm = 0.0
        self._recent.clear()

    def begin_at(self, seen: Transform, robot_from_tracker: Transform) -> None:
        """Count from where the frame is seen now, TRACKER <- MARKER, with the assistant at rest."""
        if (known := self.assistant.arm.observe().reading) is not None:
            by_joints = self._flange(known.joints_rad)
            self._flange_from_frame = by_joints.inv() * (robot_from_tracker @ seen).rigid

    def _flange(self, joints_rad: JointVector) -> RigidTransform:
        flange = self.assistant.calibrated.forward(joints_rad).to_transform()
        return self.assistant.base.rigid * flange.rigid

    def add_frame(self, frame: TrackerFrame, robot_from_tracker: Transform) -> None:
        """Add a tracker frame; one that does not show the assistant, or off the axis, tells nothing."""
        assistant = self.assistant
        axis, known = assistant.place.axis, assistant.arm.observe().reading
        reading = frame.tool(assistant.holder.frame)
        if reading.validity is not Validity.OK or axis is None or known is None:
            return
        seen = robot_from_tracker @ reading.transform(Frame.TRACKER, Frame.MARKER)
        self._recent.append((self._flange(known.joints_rad), seen.rigid))
        if len(self._recent) < READINGS:
            return
        flanges = RigidTransform.concatenate([flange for flange, _ in self._recent])
        frames = RigidTransform.concatenate([frame for _, frame in self._recent])
        if self._flange_from_frame is None:
            self._flange_from_frame = (flanges.inv() * frames).mean()
        clamp_mm = assistant.flange_from_clamp.translation_mm
        by_joints_mm = flanges.apply(clamp_mm)
        by_frame_mm = (frames * self._flange_from_frame.inv()).apply(clamp_mm)
        along = assistant.base.rotation_matrix @ axis.held.rotation_matrix[:, 2]
        way_mm = (by_frame_mm - by_joints_mm).mean(axis=0)
        self.shifted_mm = float(np.linalg.norm(np.cross(along, way_mm)))
