"""Every path is checked before anything moves, for the strategy that was chosen."""

import pytest
from clinical_case import (
    FIRST,
    ROBOT_FROM_CT,
    TRAJECTORIES,
    ClinicalCell,
    OnceForAll,
    checked_plan,
    checked_set_up,
    correspondence,
    joints_at,
    localized_fiducials,
    shifted,
)

from procedures.engine.case import Stored
from procedures.planning.errors import NotReachable
from procedures.steps.clinical.path_check import STEP, CheckedPaths
from procedures.workcell import MountedTool
from ronna_hw.frames import Transform


def check(cell: ClinicalCell, robot_from_ct: Transform = ROBOT_FROM_CT) -> Stored[CheckedPaths]:
    return cell.run(
        *(correspondence(robot_from_ct), localized_fiducials(), checked_plan(), checked_set_up(cell)), STEP
    )


def test_every_localization_and_target_has_joints_that_bring_the_tool_there(cell: ClinicalCell) -> None:
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
    assert all(motion.clear for motion in paths.motions)
    assert cell.arm.motions == []


def test_the_strategy_of_the_case_is_asked_and_recorded(cell: ClinicalCell) -> None:
    cell.strategy = OnceForAll()
    stored = check(cell)
    paths = stored.result
    assert paths.strategy == "once"
    assert tuple(paths.localizations) == (FIRST,)
    assert paths.localizations_for(TRAJECTORIES) == paths.localizations[FIRST]
    assert tuple(paths.targets) == TRAJECTORIES
    kinds = {name.partition("-")[2] for name in stored.record.parents}
    assert kinds == {"correspondence", "fiducial_localization", "plan_check", "set_up"}


def test_a_head_out_of_reach_is_refused_with_every_pose_that_fails(cell: ClinicalCell) -> None:
    with pytest.raises(NotReachable, match=r"PLAN-007.*T1/fiducial 0.*T2/target"):
        check(cell, shifted(ROBOT_FROM_CT, (900.0, 0.0, 0.0)))
    assert not any(stored.record.kind == STEP.name for stored in cell.case.standing)
