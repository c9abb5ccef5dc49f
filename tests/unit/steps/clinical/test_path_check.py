"""Every path is checked before anything moves, for the chosen strategy."""

from __future__ import annotations

import pytest
from clinical_case import FIRST, LAST, ROBOT_FROM_CT, TRAJECTORIES, ClinicalCell, shifted
from prepared_results import (
    checked_plan,
    checked_set_up,
    correspondence,
    far_away,
    global_localization,
    joints_at,
    localized_fiducials,
)
from recording_cell import RecordingOperator
from strategy_arms import Stuck
from watched_case import findings

from procedures.engine.case import Stored
from procedures.operator.question import Topic
from procedures.planning import learning_looks
from procedures.planning.errors import NotReachable
from procedures.planning.pose_name import PoseKind, PoseName
from procedures.planning.visits import Unmet
from procedures.steps.clinical.path_check import STEP, CheckedPaths
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.strategies.catalogue import find_strategy
from procedures.strategies.fixed_orientation import NEUTRAL, NeutralOrientation
from procedures.workcell import MountedTool
from ronna_hw.frames import Transform


def check(cell: ClinicalCell, robot_from_ct: Transform = ROBOT_FROM_CT) -> Stored[CheckedPaths]:
    return cell.run(
        *(global_localization(), correspondence(robot_from_ct), localized_fiducials()),
        *(checked_plan(), checked_set_up(cell), STEP),
    )


def test_every_localization_and_target_has_joints_that_reach_its_pose(cell: ClinicalCell) -> None:
    cell.carrying(MountedTool.STEREO_HEAD)
    paths = check(cell).result
    assert paths.strategy == "ocs"
    assert tuple(paths.localizations) == tuple(paths.targets) == TRAJECTORIES
    for poses in paths.localizations.values():
        assert [one.fiducial for one in poses] == [0, 1, 2, 3]
        for one in poses:
            assert one.joints_rad == pytest.approx(joints_at(cell, one.tool_pose.transform), abs=1e-9)
    cell.carrying(MountedTool.GUIDE)
    for target in paths.targets.values():
        assert target.joints_rad == pytest.approx(joints_at(cell, target.tool_pose.transform), abs=1e-9)
        assert set(target.approach_signs) <= {1, -1}
        assert all(side in (0, sign) for side, sign in zip(target.sides, target.approach_signs, strict=True))
    assert all(motion.clear for motion in paths.motions)
    assert cell.arm.motions == []


def test_the_strategy_of_the_case_is_used_and_recorded(cell: ClinicalCell) -> None:
    cell.strategy = NeutralOrientation()
    stored = check(cell)
    paths = stored.result
    assert paths.strategy == "nos"
    assert tuple(paths.localizations) == (NEUTRAL,)
    assert paths.localizations_for(None) == paths.localizations[NEUTRAL]
    assert tuple(paths.targets) == TRAJECTORIES
    kinds = {name.partition("-")[2] for name in stored.record.parents}
    assert kinds == {"correspondence", "fiducial_localization", "plan_check", "set_up"}


def test_a_head_out_of_reach_is_refused_and_the_failing_poses_are_named(cell: ClinicalCell) -> None:
    with pytest.raises(NotReachable, match=r"PLAN-007.*T1/fiducial 0.*T2/target"):
        check(cell, shifted(ROBOT_FROM_CT, (900.0, 0.0, 0.0)))
    assert not any(stored.record.kind == STEP.name for stored in cell.case.valid_results)


def test_looks_of_ocs_instead_of_chosen_ones_are_a_finding(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.strategy = find_strategy("learning")
    unclear = (Unmet(PoseName(PoseKind.TARGET, FIRST), "the guide meets the clamp", ""),)
    monkeypatch.setattr(learning_looks, "find_unclear", lambda *_: unclear)
    assert tuple(check(cell).result.localizations) == TRAJECTORIES
    (found,) = findings(cell)
    assert found.startswith("the looks of ocs are used")
    assert found.endswith(f"{FIRST}/target: the guide meets the clamp")


def plan_with_one_out_of_reach() -> CheckedPlan:
    """The last trajectory is where the arm does not reach: no angle about its axis helps."""
    checked = checked_plan()
    *others, last = checked.plan.trajectories
    plan = checked.plan.model_copy(update={"trajectories": (*others, far_away(last))})
    return checked.model_copy(update={"plan": plan})


@pytest.mark.hazard(23)
@pytest.mark.branch("UNREACHABLE")
def test_a_trajectory_out_of_reach_is_refused_without_consent(cell: ClinicalCell) -> None:
    cell.operator = RecordingOperator(Topic.UNREACHABLE)
    given = (
        global_localization(),
        correspondence(),
        localized_fiducials(),
        plan_with_one_out_of_reach(),
        checked_set_up(cell),
    )
    with pytest.raises(NotReachable, match=f"{LAST}/"):
        cell.run(*given, STEP)


@pytest.mark.hazard(23)
@pytest.mark.branch("UNREACHABLE")
def test_an_unreachable_trajectory_can_use_another_strategy_that_the_operator_accepts(
    cell: ClinicalCell,
) -> None:
    cell.strategy = Stuck(on=LAST)
    paths = check(cell).result
    (question,) = cell.operator.asked
    assert question.name == f"reach:{LAST}"
    assert "improved, ocs, jdms or nos would reach it" in question.value
    assert paths.replaced == {LAST: "improved"}
    assert (paths.strategy_of(FIRST), paths.strategy_of(LAST)) == ("stuck", "improved")
    assert tuple(paths.localizations) == tuple(paths.targets) == TRAJECTORIES
