"""Visits of two arms to postures from which one is seen: where the other leaves it a way, one arm at a time.

What is out of reach, hidden or not clear is left out, with the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np

from procedures.calibration.arm_errors import StatedArm
from procedures.engine.context import StepContext
from procedures.guards.errors import PatientUnseen
from procedures.guards.room_reading import ON_ARM
from procedures.planning.guide import depth_stop_mm
from procedures.planning.tracker_sight import explain_hidden_frame
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.room import check_room, read_localized
from procedures.steps.clinical.surroundings import planning_scene_of
from procedures.steps.clinical.two_arms.base_postures import order_by_travel
from procedures.strategies.strategy import ONE_SIDE
from procedures.workcell import MountedTool, Workcell
from procedures.workcell.assistant import Assistant
from procedures.workcell.supervised_arm import SupervisedArm
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.errors import NotClear
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import ErrorSizes
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import TrackerFrame
from ronna_hw.devices.sensors import measuring_volume_mm
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector


class PlannedGuide(NamedTuple):
    """Guide of one trajectory as planned, robot frame: the entry, the top of its bore, and the way out.

    `start_mm` is where the clamp begins to insert an instrument.
    """

    entry_mm: Array
    top_mm: Array
    start_mm: Array
    outwards: Array


@dataclass(frozen=True)
class ArmVisits:
    """Both arms of a case, as they visit postures."""

    context: StepContext
    assistant: Assistant

    @property
    def cell(self) -> Workcell:
        return self.context.workcell

    @property
    def drawn_frame(self) -> Transform:
        """Pose flange <- frame of the assistant, by its record."""
        return self.assistant.holder.flange_from_frame.transform(Frame.FLANGE, Frame.MARKER)

    @property
    def tracker_in_base(self) -> Transform:
        """Pose ASSISTANT <- TRACKER."""
        tracker = self.context.result(GlobalLocalization).robot_from_tracker.transform
        return self.assistant.base.inverse() @ tracker

    def explain_hidden(self, joints_rad: JointVector) -> str:
        """Explain why the tracker does not see the assistant's frame at these joints, or return ''."""
        one = self.assistant
        frame = one.flange_pose(joints_rad) @ self.drawn_frame
        volume_mm = measuring_volume_mm(self.cell.tracker)
        return explain_hidden_frame(self.tracker_in_base, frame, one.arm.kinematics, joints_rad, volume_mm)

    def around(self) -> Surroundings:
        """Return what surrounds both arms besides themselves, robot frame."""
        robot_from_ct = self.context.result(Correspondence).robot_from_ct.transform
        head = self.cell.master.flange_from(MountedTool.STEREO_HEAD)
        return planning_scene_of(self.context).with_stereo_head(robot_from_ct, head, None)

    def planned_guides(self) -> list[PlannedGuide]:
        """List the guides of the targets that were checked."""
        robot_from_ct = self.context.result(Correspondence).robot_from_ct.transform
        plan, guides = self.context.result(CheckedPlan), []
        for name in self.context.result(CheckedPaths).targets:
            planned = plan.trajectory(name)
            entry, target = robot_from_ct.apply([planned.entry_mm, planned.target_mm])
            outwards = (entry - target) / np.linalg.norm(entry - target)
            stop_mm = depth_stop_mm(plan.plan, planned, self.cell.tools.guide.bore)
            top = target + stop_mm * outwards
            guides.append(PlannedGuide(entry, top, top + stop_mm * outwards, outwards))
        return guides

    def read(self, count: int, settled: SupervisedArm | None = None) -> list[TrackerFrame]:
        """Read frames of the tracker, both arms at rest, in that of the localization.

        One of them may have `settled` on one side. Each look counts in the estimate of the room. Raises as
        `check_room`, except for a head that the arms hide.
        """
        sides = {} if settled is None else {ON_ARM[settled.role]: ONE_SIDE}
        try:
            look = check_room(self.context, "while the arms are measured against each other", count, sides)
        except PatientUnseen:
            return read_localized(self.context, count)
        return list(look.reading.tracker_frames)

    def visit(
        self,
        possible: Iterator[JointVector],
        at_once: int,
        arm: SupervisedArm,
        settle: Callable[[JointVector], object],
        reasons: list[str],
    ) -> Iterator[None]:
        """Have `arm` settle at postures, each joint from one side; yield after each arrival.

        `at_once` of them are ordered for a short way. Leaves out those that are not clear, without a try if
        the other arm stands there. Raises what trips an arm.
        """
        while batch := tuple(islice(possible, at_once)):
            for joints_rad in order_by_travel(arm.joints_rad(), batch):
                if not arm.rests_apart(joints_rad):
                    reasons.append("too close to the other arm")
                    continue
                try:
                    settle(joints_rad)
                except (LimitError, NotClear) as error:
                    if Lifecycle.FAULT in (self.cell.master.arm.state, self.assistant.arm.state):
                        raise
                    reasons.append(f"{error.code} ({error.meaning})")
                else:
                    yield


def list_possible(
    plan: Iterable[Callable[[], JointVector]],
    reasons: list[str],
    explain_hidden: Callable[[JointVector], str] = lambda _joints: "",
) -> Iterator[JointVector]:
    """Yield the planned joints that are in reach and, where that counts, in the tracker's view."""
    for wanted in plan:
        try:
            joints_rad = wanted()
        except LimitError as error:
            reasons.append(f"{error.code} ({error.meaning})")
            continue
        if explain_hidden(joints_rad):
            reasons.append("hidden from the tracker")
        else:
            yield joints_rad


def stated_arms(context: StepContext) -> tuple[StatedArm, StatedArm]:
    """Return master and assistant as their records state them."""
    workcell, records = context.workcell, context.workcell.calibrations
    arms = ((workcell.master.arm, records.arm), (workcell.assistant.arm, records.assistant_arm))
    master, assistant = (
        StatedArm(arm.kinematics.chain, ErrorSizes.stated(context.setting.settings, record))
        for arm, record in arms
    )
    return master, assistant
