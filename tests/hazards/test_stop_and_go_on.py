"""Hazard 5: stopped anywhere, a case continues along a newly planned path that stays clear of everything.

The arm is driven in process, planned and checked by the driver's own planner; what it passes is looked at
again, densely, by the sweep alone. Without the planner's check the arm would pass the post too near.
"""

from __future__ import annotations

import contextlib
import random
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from clinical_case import SPHERES_MM, ClinicalCell
from planned_arm import PlannedArm
from prepared_results import up_to_correspondence

from procedures.engine.engine import Engine
from procedures.engine.machine import FINISHED
from procedures.journal.errors import StepRefused
from procedures.steps.clinical import (
    at_target,
    confirmation,
    path_check,
    positioning,
    registration,
    relocalization,
    retreat,
    tool_change,
    tool_check,
)
from procedures.workcell import MountedTool
from ronna_hw.arm.clearance.bodies import Bodies
from ronna_hw.arm.clearance.sweep import sweep
from ronna_hw.arm.errors import NotClear
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.collision_config import BodyFrame, RoomBody
from ronna_hw.devices import Motion
from ronna_hw.devices.errors import MotionInterrupted
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import ArmReading
from ronna_hw.errors import LinkTimeout
from ronna_hw.vectors import JointVector

STOPS = 200
STOPPED_SHARE = 0.5  # of the motions, until there were enough stops
SENT_HOME_SHARE = 0.3  # of the stops: the step fails, the arm is sent home, the case goes on from there
LOOKED_AT = 25  # places on every way that was driven
ROUNDING_MM = 0.3  # the way is checked at samples, and looked at between them
# A thin post beside the spheres: some of the short cuts between the places of the case pass it too near.
POST_FROM_SPHERES_MM = np.array([-130.0, 15.0, 0.0])
POST_MM = 120.0
FEWEST_REFUSED = 3  # short cuts, or this test would not notice a check that is gone
STEPS = (
    path_check.STEP, relocalization.STEP, registration.STEP, tool_change.STEP, tool_check.STEP,
    positioning.STEP, at_target.STEP, retreat.STEP, confirmation.STEP,
)  # fmt: skip


@dataclass
class PlanningArm(PlannedArm):
    """Plans and checks every motion as the driver does, and is stopped at random places on the way."""

    chosen: random.Random = field(default_factory=lambda: random.Random(5))
    stopped_at: list[JointVector] = field(default_factory=list)
    least_mm: float = np.inf  # from any surface to any other, where nothing may be nearer than the margin
    refused: int = 0

    def _drive(self, motion: Motion) -> ArmReading:
        try:
            return super()._drive(motion)
        except NotClear:
            self.refused += 1
            raise

    def _follow(self, plan: MotionPlan) -> ArmReading:
        stops = len(self.stopped_at) < STOPS and self.chosen.random() < STOPPED_SHARE
        until = self.chosen.random() if stops else 1.0
        path = plan.path(self.kinematics)
        way = [path.joints(share, plan.start_rad) for share in np.linspace(0.0, until, LOOKED_AT)]
        self.least_mm = min(self.least_mm, self._least_mm(way))
        self.joints_rad = way[-1]
        self.motions.append(("way", way[-1]))
        if stops:
            self.stopped_at.append(way[-1])
            if self.chosen.random() < SENT_HOME_SHARE:
                raise LinkTimeout("stopped on its way: the step fails")
            self.state = Lifecycle.HOLD
            raise MotionInterrupted("stopped on its way")
        return self.read_state()

    def _least_mm(self, way: list[JointVector]) -> float:
        return float(sweep(Bodies(self.kinematics, self.surroundings), way).gaps_mm.min())


def stopped_case(folder: Path, arm: PlanningArm) -> ClinicalCell:
    """A case from the path check to the last retreat, with that arm."""
    cell = ClinicalCell(folder)
    x, y, z = (SPHERES_MM.mean(axis=0) + POST_FROM_SPHERES_MM).tolist()
    post = RoomBody(
        name="post",
        frame=BodyFrame.ROBOT,
        start_mm=(x, y, z - POST_MM),
        end_mm=(x, y, z + POST_MM),
        radius_mm=8.0,
    )
    bodies = cell.theatre.cell.model_copy(update={"bodies": (*cell.theatre.cell.bodies, post)})
    cell.theatre = cell.theatre.model_copy(update={"cell": bodies})
    arm.joints_rad, arm.state, arm.mounted = cell.arm.joints_rad, cell.arm.state, cell.arm.mounted
    cell.arm = cell.room.arm = arm
    cell.opened.replace_device("robot.master", arm)
    cell.carrying(MountedTool.STEREO_HEAD)
    return cell


def to_the_end(engine: Engine) -> None:
    """Run the case; whenever a step fails, bring the arm home from where it stands and go on."""
    while engine.upcoming is not None:
        try:
            engine.run_to()
        except LinkTimeout:
            while True:
                try:
                    engine.retreat_home()
                    break
                except LinkTimeout:  # stopped again on the way home
                    continue
        except StepRefused:  # the instrument was brought out between two steps that belong together
            key = engine.upcoming
            assert key is not None
            with contextlib.suppress(LinkTimeout):
                engine.run_step(engine.order.find(f"positioning:{key.trajectory}"))


@pytest.mark.hazard(5)
@pytest.mark.slow
def test_a_case_stopped_at_two_hundred_random_places_finishes_and_keeps_its_clearance(tmp_path: Path) -> None:
    arm = PlanningArm("arm")
    for number in range(STOPS):
        if len(arm.stopped_at) >= STOPS:
            break
        cell = stopped_case(tmp_path / str(number), arm)
        engine = cell.begin(*up_to_correspondence(cell), *STEPS)
        to_the_end(engine)
        assert engine.machine.state == FINISHED
        cell.journal.close()
    assert len(arm.stopped_at) == STOPS
    assert arm.least_mm >= arm.surroundings.margin_mm - ROUNDING_MM
    assert arm.refused >= FEWEST_REFUSED
