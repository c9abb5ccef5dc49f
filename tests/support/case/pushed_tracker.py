"""A clinical case with the patient's frame on the head clamp, whose tracker is pushed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from clinical_case import SPHERES_MM, TRACKER_MM, ClinicalCell, SeeingTracker
from numpy.typing import ArrayLike
from prepared_results import correspondence, global_localization

from procedures.journal.results import FramedPose, StepResult
from procedures.workcell import MountedTool
from procedures.workcell.patient_frame import seen_after
from ronna_hw.calibration import Numbers3
from ronna_hw.devices.readings import ToolReading, TrackerFrame, Validity
from ronna_hw.frames import Frame, Transform
from ronna_hw.patient_frame import MARKERS_MM, NAME

BESIDE_HEAD_MM = (120.0, 150.0, -40.0)
ON_CLAMP = Transform.of(
    Frame.TRACKER,
    Frame.PATIENT,
    translation_mm=SPHERES_MM.mean(axis=0) + BESIDE_HEAD_MM - TRACKER_MM,
)


@dataclass
class PushedTracker(SeeingTracker):
    """Sees the frame on the clamp as well, and everything from where it was pushed to."""

    move: Transform | None = None  # TRACKER now <- TRACKER at the localization
    clamp_mm: Numbers3 = (0.0, 0.0, 0.0)  # how far the frame on the clamp has moved
    clamp_hidden: bool = False

    @property
    def markers_mm(self) -> dict[str, tuple[Numbers3, ...]]:
        return {**super().markers_mm, NAME: MARKERS_MM}

    def read_frame(self, timeout_s: float = 1.0) -> TrackerFrame:
        frame = super().read_frame(timeout_s)
        x, y, z = (ON_CLAMP.translation_mm + self.clamp_mm).tolist()
        clamp = ToolReading(NAME, Validity.OK, (1.0, 0.0, 0.0, 0.0), (x, y, z), 0.1)
        if self.clamp_hidden:
            clamp = ToolReading(NAME, Validity.MISSING, None, None, None)
        frame = replace(frame, tools=(*frame.tools, clamp))
        return frame if self.move is None else seen_after(self.move, frame)

    def push(self, way_mm: ArrayLike, turn_rad: float = 0.0) -> None:
        """Push the tracker on from where it is, and turn it about its own x axis."""
        half = turn_rad / 2.0
        pushed = Transform.of(
            Frame.TRACKER,
            Frame.TRACKER,
            translation_mm=np.asarray(way_mm, dtype=float),
            quaternion_wxyz=(float(np.cos(half)), float(np.sin(half)), 0.0, 0.0),
        )
        self.move = pushed if self.move is None else pushed @ self.move


def with_patient_frame(cell: ClinicalCell, tool: MountedTool) -> PushedTracker:
    """Let a cell with that tool mounted see the frame on the clamp; return its tracker."""
    cell.carrying(tool)
    tracker = PushedTracker("tracker", state=cell.tracker.state, cell=cell)
    cell.opened.replace_tracker(tracker)
    cell.tracker = tracker
    cell.workcell.patient_frame = NAME
    return tracker


def localized_by_frame() -> tuple[StepResult, ...]:
    """Global localization relative to the frame on the clamp."""
    here = global_localization().model_copy(update={"tracker_from_patient": FramedPose.of(ON_CLAMP)})
    return here, correspondence()
