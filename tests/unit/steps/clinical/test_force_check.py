"""The force sensor of the assistant is checked by a weight before it drills."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from coded_errors import raises
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.engine.context import StepContext
from procedures.journal.errors import GateFailed
from procedures.planning.errors import NotReachable
from procedures.steps.clinical.two_arms.drill_plan import FREE_N
from procedures.steps.clinical.two_arms.force_check import (
    LEAST_UPRIGHT,
    WEIGHT_KG,
    WEIGHT_N,
    WRONG_BY_N,
    require_true_force,
)
from ronna_hw.arrays import Array
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector, Vector3
from ronna_hw.wire.room_tasks import TEST_WEIGHT

BIAS_N = (2.0, -3.0, 4.0)


class WeighingCell:
    """An assistant whose fifth joint tilts the axis of the drill, with a sensor of given errors."""

    def __init__(self, shows: Array, *, clear: bool = True, stays_N: float = 0.0) -> None:
        self.shows, self.clear, self.stays_N = shows, clear, stays_N
        self.joints: JointVector = (0.0, -2.0, 2.5, 0.0, math.pi / 2, 0.0)  # the axis is level
        self.hung_kg, self.was_hung = 0.0, False
        self.found: list[str] = []
        self.asked: list[float] = []
        self.weighed_at: list[JointVector] = []

    def flange_pose(self, joints_rad: JointVector) -> Transform:
        turn = Rotation.from_euler("y", joints_rad[4])
        return Transform(Frame.ASSISTANT, Frame.FLANGE, RigidTransform.from_components((0.0, 0.0, 0.0), turn))

    def read_force_N(self) -> Vector3:
        self.weighed_at.append(self.joints)
        turn = self.flange_pose(self.joints).rotation_matrix
        weight_N = turn.T @ (0.0, 0.0, -9.81 * self.hung_kg)
        shown_N = turn @ (self.shows @ weight_N + BIAS_N + (self.stays_N * self.was_hung, 0.0, 0.0))
        return cast("Vector3", tuple(shown_N.tolist()))

    def perform_task(self, task: Any) -> tuple[float, ...]:
        assert task.name == TEST_WEIGHT
        (self.hung_kg,) = task.numbers
        self.asked.append(self.hung_kg)
        self.was_hung |= not self.hung_kg
        return ()

    def settle(self, joints_rad: JointVector) -> None:
        self.joints = joints_rad

    def check(self) -> None:
        home = self.joints
        assistant = SimpleNamespace(
            joints_rad=lambda: self.joints,
            settle=self.settle,
            settle_motion=lambda joints_rad: joints_rad,
            return_home=lambda: self.settle(home),
            flange_pose=self.flange_pose,
            flange_from_clamp=Transform(Frame.FLANGE, Frame.TOOL, RigidTransform.identity()),
            rests_clear=lambda _joints, _tip_mm: self.clear,
            explain_blocked=lambda _motions, _start: "",
            read_force_N=self.read_force_N,
        )
        workcell = SimpleNamespace(
            assistant=assistant, start=lambda: None, clock=SimpleNamespace(sleep=lambda _s: None)
        )
        context = SimpleNamespace(
            workcell=workcell,
            trajectory="T1",
            progress=lambda _share, _what: None,
            perform_task=self.perform_task,
            find=self.found.append,
        )
        require_true_force(cast("StepContext", context))


@pytest.mark.hazard(66)
def test_a_weight_hangs_along_the_axis_of_the_drill_and_is_taken_off_again() -> None:
    cell = WeighingCell(np.eye(3))
    home = cell.joints
    cell.check()
    assert cell.asked == [WEIGHT_KG, 0.0]
    assert {round(abs(math.cos(joints[4])), 6) for joints in cell.weighed_at} == {1.0}
    assert cell.joints == home
    assert cell.found == ["the assistant's force sensor shows a weight of 19.6 N as 19.6 N, and 0.0 N across"]


WRONG = {
    "nine tenths": 0.9 * np.eye(3),
    "a tenth too much": 1.1 * np.eye(3),
    "a fifth": 0.2 * np.eye(3),
    "another sign": -np.eye(3),
    "the drill's axis alone": np.diag([1.0, 1.0, 0.9]),
    "two axes exchanged": np.eye(3)[[0, 2, 1]],
}


@pytest.mark.hazard(66)
@pytest.mark.parametrize("shows", WRONG.values(), ids=WRONG)
def test_a_force_sensor_of_a_wrong_scale_or_wiring_is_not_drilled_by(shows: Array) -> None:
    cell = WeighingCell(shows)
    with raises(GateFailed, match=r"shows a weight of 19\.6 N as x"):
        cell.check()
    assert cell.hung_kg == 0.0  # nobody leaves it there


@pytest.mark.hazard(66)
def test_a_force_that_does_not_come_back_or_is_none_is_not_drilled_by() -> None:
    with raises(GateFailed, match="taken off than before"):
        WeighingCell(np.eye(3), stays_N=1.5).check()
    with raises(GateFailed, match="sends nothing"):
        WeighingCell(np.full((3, 3), math.nan)).check()


def test_an_assistant_that_cannot_hold_its_clamp_upright_is_told() -> None:
    with raises(NotReachable, match="upright"):
        WeighingCell(np.eye(3), clear=False).check()


def test_a_scale_that_is_wrong_by_more_than_an_eighth_does_not_pass() -> None:
    """A sensor that itself errs by as much as one may that drills."""
    assert (WRONG_BY_N + FREE_N) / (LEAST_UPRIGHT * WEIGHT_N) < 0.125
