"""On a phantom the stereo head takes the place of the guide and measures a ball at each target."""

from __future__ import annotations

import numpy as np
import pytest
from clinical_case import FIRST, ROBOT_FROM_CT, SPHERES_MM, TRAJECTORIES, ClinicalCell
from prepared_results import (
    checked_paths,
    checked_plan,
    correspondence,
    global_localization,
    localized_fiducials,
    plan,
    registered_robot,
)
from recording_cell import RecordingOperator

from procedures.engine.order import order_of
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Topic
from procedures.planning.errors import NotReachable
from procedures.steps.catalogue import clinical_steps
from procedures.steps.clinical.results import RegisteredRobot
from procedures.steps.clinical.target_measurement import STEP, MeasuredTarget
from procedures.strategies.catalogue import STRATEGIES
from procedures.strategies.strategy import Strategy
from procedures.workcell import MountedTool
from ronna_hw.arrays import Array

BESIDE_MM = np.array([0.3, -0.2, 0.1])


def measured(cell: ClinicalCell, beside_mm: Array = BESIDE_MM) -> MeasuredTarget:
    cell.carrying(MountedTool.STEREO_HEAD)
    targets = ROBOT_FROM_CT.apply([one.target_mm for one in plan().trajectories]) + beside_mm
    cell.workcell.spheres_mm = np.vstack([SPHERES_MM, targets])
    return cell.run(
        *(registered_robot(), checked_paths(cell), checked_plan(), localized_fiducials()),
        *(global_localization(), correspondence()),
        STEP,
    ).result


def test_the_error_at_the_target_is_measured_in_the_tool_frame_and_the_head_is_withdrawn(
    cell: ClinicalCell,
) -> None:
    result = measured(cell)
    assert result.error_mm == pytest.approx(np.linalg.norm(BESIDE_MM), abs=1e-6)
    assert result.ball_tool_mm is not None
    turned = result.tool_pose.transform.rotation_matrix @ result.ball_tool_mm
    assert turned == pytest.approx(BESIDE_MM, abs=1e-6)
    (_, over), *_, (_, out) = cell.arm.motions
    assert out == pytest.approx(over, abs=1e-9)


def test_a_missing_ball_is_recorded_without_ending_the_step(cell: ClinicalCell) -> None:
    result = measured(cell, np.array([0.0, 0.0, 400.0]))
    assert result.error_mm is None
    assert result.not_measured == "no sphere in view"


def test_the_arm_does_not_move_without_confirmation(cell: ClinicalCell) -> None:
    cell.operator = RecordingOperator(Topic.APPROACH)
    with pytest.raises(NotConfirmed, match=f"on a phantom with a ball at {FIRST}"):
        measured(cell)
    assert cell.arm.motions == []


def test_a_blocked_target_is_refused_and_named(cell: ClinicalCell) -> None:
    cell.arm.blocked = lambda _start, _target: True
    with pytest.raises(NotReachable, match=f"{FIRST} cannot be reached"):
        measured(cell)


@pytest.mark.parametrize("strategy", STRATEGIES, ids=lambda one: one.name)
def test_targets_are_measured_before_the_tool_change_and_positioned_by_their_own_registration(
    strategy: Strategy,
) -> None:
    order = order_of(
        clinical_steps(measure_targets=True),
        TRAJECTORIES,
        localizes_per_trajectory=strategy.localizes_per_trajectory,
    )
    names = [str(key) for key in order.sequence]
    exchanged = names.index("tool_change")
    localized = [f":{one}" for one in TRAJECTORIES] if strategy.localizes_per_trajectory else [""]
    assert names[names.index("path_check") + 1 : exchanged] == [
        *(f"{step}{one}" for one in localized for step in ("relocalization", "registration")),
        *(f"target_measurement:{one}" for one in TRAJECTORIES),
    ]
    for one in TRAJECTORIES:
        before = order.before(order.find(f"positioning:{one}"))
        registrations = [key.trajectory for key in before if key.name == RegisteredRobot.kind]
        assert registrations == [one if strategy.localizes_per_trajectory else None]
