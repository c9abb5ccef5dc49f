"""Readings of the tracker at rest: mean poses of both frames."""

from __future__ import annotations

from dataclasses import dataclass

from procedures.workcell.patient_frame import as_patient
from procedures.workcell.tracker_look import mean_pose
from ronna_hw.devices.readings import TrackerFrame
from ronna_hw.devices.sensors import OpticalTracker, new_frames
from ronna_hw.frames import Transform
from studies.errors import TRACKER_NOT_SIMULATED
from studies.low_cost.devices import FRAME_LIMIT_S, PHANTOM_FRAME, TOOL_FRAME

LEAST_SHARE = 0.5  # of the frames that must show a tool


@dataclass(frozen=True)
class StudiedSight:
    """Mean poses TRACKER <- MARKER of the tool's frame and TRACKER <- PATIENT of the phantom's."""

    tool: Transform
    phantom: Transform

    @property
    def patient_from_marker(self) -> Transform:
        """Pose of the tool's frame in that of the phantom."""
        return self.phantom.inverse() @ self.tool


def look(tracker: OpticalTracker, frames: int) -> StudiedSight | None:
    """Average `frames` measurements, or return None where either frame is hidden."""
    read = list(new_frames(tracker, frames, timeout_s=FRAME_LIMIT_S))
    tool, phantom = (_mean_pose(read, name) for name in (TOOL_FRAME, PHANTOM_FRAME))
    return None if tool is None or phantom is None else StudiedSight(tool, as_patient(phantom))


def require_look(tracker: OpticalTracker, frames: int) -> StudiedSight:
    """Average `frames` measurements. Raises STU-008 where either frame is hidden."""
    if (found := look(tracker, frames)) is None:
        raise TRACKER_NOT_SIMULATED("the tracker does not see both frames")
    return found


def _mean_pose(read: list[TrackerFrame], name: str) -> Transform | None:
    return mean_pose(read, name, max(1, round(LEAST_SHARE * len(read))))
