"""Global localization: the tracker reads the reference frame on the tool and all stray spheres.

The arm rests with its correction stream off. FRAMES measurements are averaged; frames that the tracker
repeats because it is polled faster than it measures do not count. With the patient's frame on the head clamp,
only those that show it count, and a reading in which the tracker was pushed is repeated.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.journal.errors import GateFailed
from procedures.journal.results import FramedPose, StepResult
from procedures.operator.question import Topic
from procedures.registration.movement import LEAST_POINTS
from procedures.steps.clinical.cart_lock import LockedCart
from procedures.steps.clinical.head_clamp import ClampedHead
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.clinical.tool_mounting import exchange_tool
from procedures.steps.conditions import needs_tool
from procedures.workcell import MountedTool, Workcell
from procedures.workcell.patient_frame import STILL_MM, hold_to_patient_frame
from procedures.workcell.tracker_look import average_pose, read_frames_at_rest, robot_from_marker
from ronna_hw.arrays import Array
from ronna_hw.calibration import Numbers3
from ronna_hw.devices.readings import TrackerFrame
from ronna_hw.devices.strays import StrayAverage, average_strays
from ronna_hw.frames import Transform
from ronna_hw.text import format_against_limit, format_count
from ronna_hw.vectors import JointVector, vector3

MOST_READINGS = 3  # of a second each, until one in which nobody has pushed the tracker
# Safety against spheres that move while they are localized (U).
SPREAD_LIMIT_MM = 1.0  # rms of one sphere over the frames; more means that something moved


class GlobalLocalization(StepResult, kind="global_localization"):
    """Coarse positions of the spheres in the room, measured by the tracker."""

    frames: int = Field(description="Measurements that were averaged.")
    points_robot_mm: tuple[Numbers3, ...] = Field(description="Spheres in the robot frame.")
    points_tracker_mm: tuple[Numbers3, ...] = Field(description="The same in the tracker frame.")
    spread_mm: tuple[float, ...] = Field(description="Rms of each sphere over the frames.")
    counts: tuple[int, ...] = Field(description="Number of frames in which each was seen.")
    outliers: tuple[int, ...] = Field(description="Number of frames left out.")
    rejected_strays: int = Field(description="Groups of strays seen too rarely to be a sphere.")
    lost_readings: int = Field(description="Replies lost or corrupted on the line.")
    robot_from_tracker: FramedPose = Field(description="Pose robot <- tracker.")
    joints_rad: JointVector = Field(description="Joints measured at the same time.")
    tracker_from_patient: FramedPose | None = Field(
        default=None,
        description="Pose tracker <- frame on the head clamp, relative to which the spheres were measured; "
        "null without one.",
    )

    @property
    def points_mm(self) -> Array:
        """Spheres (n, 3), robot frame, mm."""
        return np.asarray(self.points_robot_mm, dtype=float).reshape(-1, 3)


def run(context: StepContext) -> Outcome[GlobalLocalization]:
    """Measure all stray spheres in the robot frame, via the reference frame M."""
    for before in context.reads:
        context.result(before)
    least = min(LEAST_POINTS, context.result(ClampedHead).implanted) if ClampedHead in context.reads else 1
    workcell = context.workcell
    if workcell.master.tool is MountedTool.GUIDE:  # earlier localizations are void
        exchange_tool(context, MountedTool.STEREO_HEAD)
    on_arm, name = workcell.calibrations.tracker_frame.tool, workcell.patient_frame
    frames, lost, patient = _read_at_rest(context, on_arm, name)
    tracker_from_marker = average_pose(frames, on_arm)
    strays = average_strays(frames)
    _check_count(workcell, len(strays.groups), least)
    spread_mm = _require_spread_mm(strays)
    joints = workcell.master.joints_rad()
    robot_from_tracker = robot_from_marker(workcell, joints) @ tracker_from_marker.inverse()
    groups = strays.groups
    points = np.array([group.mean_mm for group in groups]).reshape(-1, 3)
    return Outcome(
        GlobalLocalization(
            frames=len(frames),
            points_robot_mm=tuple(map(vector3, robot_from_tracker.apply(points) if len(points) else points)),
            points_tracker_mm=tuple(map(vector3, points)),
            spread_mm=tuple(float(group.spread_mm) for group in groups),
            counts=tuple(int(group.count) for group in groups),
            outliers=tuple(int(group.outliers) for group in groups),
            rejected_strays=len(strays.rejected),
            lost_readings=lost,
            robot_from_tracker=FramedPose.of(robot_from_tracker),
            joints_rad=joints,
            tracker_from_patient=None if patient is None else FramedPose.of(patient),
        ),
        summary=(format_count(len(groups), "stray sphere") if groups else "the clamp without spheres")
        + f" in {format_count(len(frames), 'frame')}"
        + (f", largest spread {spread_mm:.2f} mm" if groups else "")
        + (f", {'relative to' if groups else 'by'} {name}" if patient is not None else "")
        + (f", {format_count(lost, 'reading')} lost on the line" if lost else ""),
    )


def _read_at_rest(
    context: StepContext, on_arm: str, name: str | None
) -> tuple[list[TrackerFrame], int, Transform | None]:
    """Return frames, how many were lost, and the pose TRACKER <- PATIENT, of a reading without a push."""
    workcell, lost_in_all = context.workcell, 0
    words = "reading the tracker"
    for _ in range(MOST_READINGS):
        frames, lost = read_frames_at_rest(workcell, partial(_show, context, words))
        lost_in_all += lost
        if name is None:
            return frames, lost_in_all, None
        held = hold_to_patient_frame(frames, name, workcell.tracker.markers_mm[name], on_arm)
        if not held.pushed:
            return held.frames, lost_in_all, held.patient
        context.find("the tracker, or the frame on the head clamp, was pushed while the tracker was read")
        words = "reading the tracker again"
    raise GateFailed(
        "the tracker, or the frame on the head clamp, moved in each reading",
        limit=f"one reading at rest within {STILL_MM:g} mm",
        got=f"moved in all {MOST_READINGS}",
        action="Lock the tracker's stand and the clamp, let nobody touch them, then repeat the step.",
    )


def _show(context: StepContext, words: str, share: float) -> None:
    context.progress(share, words)


def _check_count(workcell: Workcell, seen: int, least: int) -> None:
    """Raise PRO-007 for too few spheres, before the result could replace a good one."""
    if seen < least:
        raise GateFailed(
            "the tracker sees too few spheres",
            limit=f"at least {least} spheres",
            got=str(seen),
            action=f"Clear the line of sight, if need be by sending {workcell.phrases.arms} home, "
            "then repeat the step.",
        )


def _require_spread_mm(strays: StrayAverage) -> float:
    spread_mm = max((float(group.spread_mm) for group in strays.groups), default=0.0)
    if spread_mm > SPREAD_LIMIT_MM:
        raise GateFailed(
            "a sphere moved while the tracker was measuring",
            limit=f"{SPREAD_LIMIT_MM} mm",
            got=f"{format_against_limit(spread_mm, SPREAD_LIMIT_MM, 2)} mm",
        )
    return spread_mm


def _needs_stereo_head(context: StepContext) -> tuple[str, ...]:
    """Require the stereo head on the arm, or the guide on an arm parked for an exchange."""
    workcell = context.workcell
    unmet = needs_tool(MountedTool.STEREO_HEAD)(context)
    if not unmet or workcell.master.place.is_on_axis or workcell.master.tool is not MountedTool.GUIDE:
        return unmet
    return (
        () if workcell.master.place.is_home else (*unmet, "send it home; the stereo head is remounted there")
    )


STEP = StepSpec(
    GlobalLocalization,
    "Localize the head with the tracker",
    Phase.PREPARATION,
    run,
    asks=(Topic.TOOL_CHANGE,),
    reads=(CheckedSetUp,),
    preconditions=_needs_stereo_head,
)
IN_CASE = replace(STEP, reads=(CheckedSetUp, ClampedHead, LockedCart))  # where a patient lies
