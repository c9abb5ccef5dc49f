"""The way home: straight if that is clear, otherwise back the way the arm came."""

from collections.abc import Callable

import pytest
from recording_cell import RecordingCell

from procedures.journal.errors import StepRefused
from procedures.strategies.strategy import ONE_SIDE, approach_joints
from procedures.workcell.arm_history import AT_PLACE_RAD, ArmHistory
from ronna_hw.arm.errors import NotClear
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import LinkTimeout
from ronna_hw.vectors import JointVector

HOME, ONE, TWO, THREE = ((A1, -1.5, 1.5, 0.0, 1.5, 0.0) for A1 in (0.0, 0.1, 0.2, 0.3))
HOMING = [approach_joints(HOME, ONE_SIDE), HOME]


def blocked_beyond(clear_rad: float) -> Callable[[JointVector, JointVector], bool]:
    return lambda start, target: abs(target[0] - start[0]) > clear_rad


def motions(cell: RecordingCell) -> list[JointVector]:
    return [joints_rad for _, joints_rad in cell.arm.motions]


@pytest.fixture
def away(cell: RecordingCell) -> RecordingCell:
    """An arm that came from home by two places."""
    cell.arm.joints_rad, cell.arm.state = HOME, Lifecycle.ACTIVE
    cell.workcell.master.set_home()
    for place in (ONE, TWO):
        cell.workcell.master.go(place)
    cell.arm.motions.clear()
    return cell


def test_the_arm_goes_straight_home_if_the_way_is_clear(away: RecordingCell) -> None:
    assert away.workcell.master.return_home().joints_rad == HOME
    assert motions(away) == HOMING


def test_the_arm_goes_back_the_way_it_came_if_the_straight_way_is_blocked(away: RecordingCell) -> None:
    away.arm.blocked = blocked_beyond(0.15)
    away.workcell.master.return_home()
    assert motions(away) == [TWO, ONE, *HOMING]


def test_an_interrupted_way_back_continues_without_visiting_its_far_end_again(away: RecordingCell) -> None:
    away.workcell.master.go(THREE)
    away.arm.motions.clear()
    away.arm.blocked = blocked_beyond(0.15)
    clear = away.arm.blocked

    def fails_from_two_to_one(start: JointVector, target: JointVector) -> bool:
        if len(away.arm.motions) == 2:
            raise LinkTimeout("telegrams ceased")
        return clear(start, target)

    away.arm.blocked = fails_from_two_to_one
    with pytest.raises(LinkTimeout):
        away.workcell.master.return_home()
    away.arm.blocked = clear
    away.workcell.master.return_home()
    assert motions(away)[2:] == [TWO, ONE, *HOMING]


def test_the_way_is_forgotten_at_home(away: RecordingCell) -> None:
    away.workcell.master.return_home()
    away.arm.joints_rad, away.arm.blocked = TWO, blocked_beyond(0.15)  # brought there by other hands
    with pytest.raises(NotClear):
        away.workcell.master.return_home()


@pytest.mark.parametrize(("beside", "at_home"), [(0.9, True), (1.1, False)])
def test_the_arm_is_at_home_when_every_joint_is_near_its_home_angle(
    away: RecordingCell, beside: float, at_home: bool
) -> None:
    away.arm.joints_rad = (*HOME[:5], HOME[5] + beside * AT_PLACE_RAD)
    away.workcell.master.compare_place()
    assert away.workcell.master.place.is_home is at_home


def test_a_restored_history_leads_back_like_the_original_one(cell: RecordingCell) -> None:
    cell.arm.joints_rad, cell.arm.state = TWO, Lifecycle.ACTIVE
    cell.arm.blocked = blocked_beyond(0.15)
    cell.workcell.master.restore_history(ArmHistory(trail=(ONE, TWO)))
    cell.workcell.master.restore_home(HOME)
    cell.workcell.master.return_home()
    assert motions(cell) == [TWO, ONE, *HOMING]


def test_nothing_moves_home_before_a_home_is_set(cell: RecordingCell) -> None:
    with pytest.raises(StepRefused, match="Run set_up first"):
        cell.workcell.master.return_home()
    assert cell.arm.motions == []
