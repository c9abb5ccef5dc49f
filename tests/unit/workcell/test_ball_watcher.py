"""Moving between acquisitions: one approach side, the way via home, the search, the surroundings."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from recording_cell import RecordingCell

from procedures.calibration.pose_set import plan_calibration_looks
from procedures.relocalization.errors import NoSphere, SphereNotInView
from procedures.steps.calibration.ball_place import BallPlace
from procedures.strategies.strategy import APPROACH_RAD, ONE_SIDE, approach_joints
from procedures.workcell import MountedTool
from procedures.workcell.ball_watcher import BallWatcher, build_ball_surroundings
from procedures.workcell.stereo_look import Look
from ronna_hw.arm.errors import NotClear
from ronna_hw.arm.pose import radians6
from ronna_hw.devices.lifecycle import Lifecycle

HOME_RAD = radians6(0.0, -75.0, 99.0, 0.0, 66.0, 180.0)
BALL_MM = np.array([720.0, -10.0, 310.0])
PLACE = BallPlace(ball_mm=(720.0, -10.0, 310.0), others_mm=())


@pytest.fixture
def watcher(cell: RecordingCell, monkeypatch: pytest.MonkeyPatch) -> BallWatcher:
    """A watcher to whom every look shows nothing."""
    nothing = Look(SimpleNamespace(), None, None, None, NoSphere("no sphere in view"))  # type: ignore[arg-type]
    monkeypatch.setattr(cell.workcell, "look", lambda: nothing)
    cell.arm.joints_rad = HOME_RAD
    cell.arm.state = Lifecycle.ACTIVE
    cell.workcell.master.mount.check(MountedTool.STEREO_HEAD)
    cell.workcell.master.set_home()
    return BallWatcher(cell.workcell, BALL_MM)


def refuse(cell: RecordingCell, *numbers: int) -> None:
    """Refuse the joint moves with these numbers as not clear."""
    asked = 0

    def blocked(_start: object, _target: object) -> bool:
        nonlocal asked
        asked += 1
        return asked in numbers

    cell.arm.blocked = blocked


def targets(cell: RecordingCell) -> list[tuple[float, ...]]:
    return [target for _, target in cell.arm.motions]


def test_every_pose_is_approached_from_the_same_side_in_every_joint(
    cell: RecordingCell, watcher: BallWatcher
) -> None:
    for planned in plan_calibration_looks(PLACE.reference, BALL_MM, 10):
        assert watcher.observe(planned) is None
    before, at = np.array(targets(cell)[0::2]), np.array(targets(cell)[1::2])
    assert len(at) == 10
    assert at - before == pytest.approx(APPROACH_RAD)
    assert watcher.rejected == {"no sphere in view": 10}


def test_a_blocked_way_is_replaced_by_one_via_home(cell: RecordingCell, watcher: BallWatcher) -> None:
    refuse(cell, 1)
    watcher.observe(PLACE.first_look)
    assert len(targets(cell)) == 4
    assert targets(cell)[:2] == [approach_joints(HOME_RAD, ONE_SIDE), HOME_RAD]


def test_an_unreachable_acquisition_is_counted_and_skipped(cell: RecordingCell, watcher: BallWatcher) -> None:
    refuse(cell, 1, 4)  # neither straight nor by way of home
    assert watcher.observe(PLACE.first_look) is None
    (reason,) = watcher.rejected
    assert reason.startswith("ARM-007 (a body of the arm or its tool comes too close")


def test_a_tripped_arm_is_not_taken_for_a_pose_out_of_reach(
    cell: RecordingCell, watcher: BallWatcher
) -> None:
    refuse(cell, 1, 4)
    cell.arm.state = Lifecycle.FAULT
    with pytest.raises(NotClear):
        watcher.observe(PLACE.first_look)


def test_a_missing_ball_is_searched_for_and_then_refused(cell: RecordingCell, watcher: BallWatcher) -> None:
    with pytest.raises(SphereNotInView, match="STE-009"):
        watcher.find(PLACE.first_look)
    assert len(targets(cell)) == 2 * (1 + 36)


def test_a_search_for_a_ball_passes_over_poses_that_are_not_clear_and_still_says_what_was_not_found(
    cell: RecordingCell, watcher: BallWatcher
) -> None:
    refuse(cell, 5, 8)  # of the second pose around, neither straight nor by way of home
    with pytest.raises(SphereNotInView, match="STE-009: no sphere in 35 image pairs, 1 pose not clear"):
        watcher.find(PLACE.first_look)


def test_a_search_for_a_ball_in_which_the_arm_trips_ends_with_that(
    cell: RecordingCell, watcher: BallWatcher
) -> None:
    def trips(_start: object, _target: object) -> bool:
        if len(targets(cell)) == 4:
            cell.arm.state = Lifecycle.FAULT
        return cell.arm.state is Lifecycle.FAULT

    cell.arm.blocked = trips
    with pytest.raises(NotClear):
        watcher.find(PLACE.first_look)


def test_the_surroundings_include_the_ball_its_stand_other_balls_and_the_stereo_head(
    cell: RecordingCell,
) -> None:
    tool = cell.workcell.master.flange_from(MountedTool.STEREO_HEAD)
    around = build_ball_surroundings(cell.theatre.cell, tool, BALL_MM, [[700.0, 60.0, 300.0]])
    assert [obstacle.name for obstacle in around.obstacles] == ["ball's stand", "ball", "other ball 1"]
    assert {"left camera", "right camera"} <= {part.name for part in around.tool}
