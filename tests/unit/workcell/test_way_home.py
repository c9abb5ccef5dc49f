"""The way home: straight if that is clear, otherwise back the way the arm came."""

import pytest

from procedures.journal.errors import StepRefused
from procedures.journal.journal import Entry
from procedures.operator.errors import OperatorAborted
from procedures.workcell.arm_history import ArmHistory
from procedures.workcell.arm_view import AT_PLACE_RAD, stands_at
from procedures.workcell.way_home import WayHome
from ronna_hw.arm.errors import NotClear
from ronna_hw.devices.readings import ArmReading, JointVector, Stamp, Validity

HOME, ONE, TWO, THREE = ((A1, -1.5, 1.5, 0.0, 1.5, 0.0) for A1 in (0.0, 0.1, 0.2, 0.3))


class Arm:
    """Stands where it was moved to; a way longer than `clear_rad` is not clear."""

    def __init__(self) -> None:
        self.joints_rad: JointVector = HOME
        self.clear_rad = 1.0
        self.moves: list[tuple[str, JointVector]] = []
        self.stopped_after: int | None = None  # moves
        self.history = ArmHistory()
        self.way = WayHome(lambda: self.joints_rad, lambda: self.history.trail, self.move)

    def move(self, what: str, joints_rad: JointVector) -> ArmReading:
        if abs(joints_rad[0] - self.joints_rad[0]) > self.clear_rad:
            raise NotClear("the head is in the way")
        self.history = self.history.after({"entry": Entry.MOTION, "what": what})
        if len(self.moves) == self.stopped_after:
            raise OperatorAborted("left while the motion was stopped")
        self.moves.append((what, joints_rad))
        self.joints_rad = joints_rad
        at_home = stands_at(joints_rad, HOME)
        self.history = self.history.after(
            {"entry": Entry.MOVED, "joints_rad": list(joints_rad), "at_home": at_home}
        )
        return ArmReading(Stamp(0, 0, 0.0), Validity.OK, joints_rad, None, moving=False)


@pytest.fixture
def arm() -> Arm:
    """Came from home by two places."""
    arm = Arm()
    arm.way.set_home()
    for place in (ONE, TWO):
        arm.move("go", place)
    arm.moves.clear()
    return arm


def test_the_arm_goes_straight_home_if_the_way_is_clear(arm: Arm) -> None:
    assert arm.way.go_back().joints_rad == HOME
    assert arm.moves == [("home", HOME)]


def test_the_arm_goes_back_the_way_it_came_if_the_straight_way_is_blocked(arm: Arm) -> None:
    arm.clear_rad = 0.15
    arm.way.go_back()
    assert arm.moves == [("back", TWO), ("back", ONE), ("home", HOME)]


def test_an_interrupted_way_back_continues_without_visiting_its_far_end_again(arm: Arm) -> None:
    arm.move("go", THREE)
    arm.moves.clear()
    arm.clear_rad, arm.stopped_after = 0.15, 2  # on the way from TWO to ONE
    with pytest.raises(OperatorAborted):
        arm.way.go_back()
    arm.stopped_after = None
    arm.way.go_back()
    assert arm.moves[2:] == [("back", TWO), ("back", ONE), ("home", HOME)]


def test_the_way_is_forgotten_at_home(arm: Arm) -> None:
    arm.way.go_back()
    arm.joints_rad, arm.clear_rad = TWO, 0.15  # brought there by other hands
    with pytest.raises(NotClear):
        arm.way.go_back()


@pytest.mark.parametrize(("beside", "at_home"), [(0.9, True), (1.1, False)])
def test_the_arm_is_at_home_when_every_joint_is_near_its_home_angle(
    arm: Arm, beside: float, at_home: bool
) -> None:
    arm.joints_rad = (*HOME[:5], HOME[5] + beside * AT_PLACE_RAD)
    assert arm.way.is_home(arm.joints_rad) is at_home


def test_a_restored_way_leads_back_like_the_original_one(arm: Arm) -> None:
    again = Arm()
    again.joints_rad, again.clear_rad = TWO, 0.15
    again.way.take_up(HOME)
    again.history = ArmHistory(trail=(ONE, TWO))
    again.way.go_back()
    assert [place for _, place in again.moves] == [TWO, ONE, HOME]


def test_nothing_moves_home_before_a_home_is_set() -> None:
    arm = Arm()
    assert arm.way.is_home(arm.joints_rad) is None
    with pytest.raises(StepRefused, match="Run set_up first"):
        arm.way.go()
    assert arm.moves == []
