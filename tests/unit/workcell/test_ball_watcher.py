"""Driving from look to look: one approach side, the way by home, the search, what stands around, no ball."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from recording_cell import RecordingCell
from scipy.spatial.transform import Rotation

from procedures.calibration.errors import NoBall, PosesOutOfReach, TooFewPoses
from procedures.calibration.pose_set import PlannedLook, calibration_looks, check_variants
from procedures.engine.order import order_of
from procedures.engine.step import Outcome, Phase, StepSpec
from procedures.relocalization.errors import NoSphere, SphereNotInView
from procedures.steps.calibration.ball_observation import check_look, refuse_too_few
from procedures.steps.calibration.ball_place import BallPlace, place_step
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.workcell import MountedTool
from procedures.workcell.ball_watcher import BallWatcher, around_ball
from procedures.workcell.stereo_look import Look
from procedures.workcell.workcell import APPROACH_RAD
from ronna_hw.arm.angles import radians6
from ronna_hw.arm.errors import NotClear
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import EXIT_REFUSED
from ronna_hw.frames import Frame, Transform

HOME_RAD = radians6(0.0, -75.0, 99.0, 0.0, 66.0, 180.0)
BALL_MM = np.array([720.0, -10.0, 310.0])
PLACE = BallPlace(ball_mm=(720.0, -10.0, 310.0), others_mm=())
IDENTITY = Transform.of(Frame.ROBOT, Frame.TRACKER, translation_mm=(0, 0, 0), quaternion_wxyz=(1, 0, 0, 0))


@pytest.fixture
def watcher(cell: RecordingCell, monkeypatch: pytest.MonkeyPatch) -> BallWatcher:
    """A watcher to whom every look shows nothing."""
    nothing = Look(SimpleNamespace(), None, None, None, NoSphere("no sphere in view"))  # type: ignore[arg-type]
    monkeypatch.setattr(cell.workcell, "look", lambda: nothing)
    cell.arm.joints_rad = HOME_RAD
    cell.arm.state = Lifecycle.ACTIVE
    cell.workcell.check_mounted(MountedTool.STEREO_HEAD)
    cell.workcell.set_home()
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


def test_every_pose_is_taken_from_the_same_side_in_every_joint(
    cell: RecordingCell, watcher: BallWatcher
) -> None:
    for planned in calibration_looks(PLACE.reference, BALL_MM, 10):
        assert watcher.observe(planned) is None
    before, at = np.array(targets(cell)[0::2]), np.array(targets(cell)[1::2])
    assert len(at) == 10
    assert at - before == pytest.approx(APPROACH_RAD)
    assert watcher.rejected == {"no sphere in view": 10}


def test_a_way_that_is_not_clear_leads_by_home(cell: RecordingCell, watcher: BallWatcher) -> None:
    refuse(cell, 1)
    watcher.observe(PLACE.first_look)
    assert len(targets(cell)) == 3
    assert targets(cell)[0] == HOME_RAD


def test_a_look_that_cannot_be_taken_is_counted_and_left_out(
    cell: RecordingCell, watcher: BallWatcher
) -> None:
    refuse(cell, 1, 3)  # neither straight nor by way of home
    assert watcher.observe(PLACE.first_look) is None
    assert watcher.rejected == {"ARM-007": 1}


def test_an_arm_that_tripped_is_not_taken_for_a_pose_out_of_reach(
    cell: RecordingCell, watcher: BallWatcher
) -> None:
    refuse(cell, 1, 3)
    cell.arm.state = Lifecycle.FAULT
    with pytest.raises(NotClear):
        watcher.observe(PLACE.first_look)


def test_a_ball_that_is_not_there_is_searched_for_and_refused(
    cell: RecordingCell, watcher: BallWatcher
) -> None:
    with pytest.raises(SphereNotInView, match="STE-009"):
        watcher.find(PLACE.first_look)
    assert len(targets(cell)) == 2 * (1 + 36)


def test_the_arm_is_told_of_ball_stand_neighbours_and_its_own_head(cell: RecordingCell) -> None:
    tool = cell.workcell.flange_from(MountedTool.STEREO_HEAD)
    around = around_ball(cell.theatre.cell, tool, BALL_MM, [[700.0, 60.0, 300.0]])
    assert [obstacle.name for obstacle in around.obstacles] == ["ball's stand", "ball", "other ball 1"]
    assert {"left camera", "right camera"} <= {part.name for part in around.tool}


def place_among(cell: RecordingCell, *points: tuple[float, float, float]) -> BallPlace:
    """The ball that is chosen when the tracker has seen these."""
    seen = GlobalLocalization.model_construct(points_robot_mm=points, robot_from_tracker=IDENTITY)
    tracked = StepSpec(GlobalLocalization, "", Phase.PREPARATION, lambda _context: Outcome(seen))
    cell.case.store = lambda key, result, parents: SimpleNamespace(  # type: ignore[method-assign]
        record=SimpleNamespace(identifier=key.name, sha256="", parents={}), result=result
    )
    cell.case.get = lambda model, _trajectory=None: cell.case.find(model, None)  # type: ignore[method-assign]
    cell.workcell.check_mounted(MountedTool.STEREO_HEAD)
    cell.arm.joints_rad = HOME_RAD
    cell.engine(order_of([tracked, place_step(None)], ())).run_to()
    return cell.case.get(BallPlace).result


def test_without_a_ball_that_stands_alone_nothing_begins(cell: RecordingCell) -> None:
    with pytest.raises(NoBall, match="CAL-009") as refused:
        place_among(cell, (700.0, 0.0, 300.0), (710.0, 0.0, 300.0))
    assert refused.value.exit_code == EXIT_REFUSED


def test_the_ball_nearest_to_the_head_is_taken(cell: RecordingCell) -> None:
    far, near, other = (870.0, 370.0, 1060.0), (720.0, -10.0, 318.0), (600.0, 200.0, 200.0)
    place = place_among(cell, far, near, other)
    assert place.ball_mm == near
    assert place.others_mm == (far, other)


@pytest.mark.parametrize(
    ("reason", "error"), [("ARM-007", PosesOutOfReach), ("no sphere in view", TooFewPoses)]
)
def test_too_few_looks_are_explained_by_their_commonest_reason(
    watcher: BallWatcher, reason: str, error: type[Exception]
) -> None:
    watcher.rejected[reason] = 40
    with pytest.raises(error, match=f"40 x {reason}"):
        refuse_too_few(watcher, 30)


class Watcher:
    """Takes looks unless they are turned too far; notes the joint angles that it is sent back to."""

    def __init__(self) -> None:
        self.sent_back: list[tuple[float, ...]] = []

    def observe(self, planned: PlannedLook) -> Any:
        turned = planned.pose.rigid.rotation.as_euler("ZYX", degrees=True)[0]
        return (
            None
            if abs(turned) > 30.0
            else SimpleNamespace(orientation=planned.orientation, joints_rad=HOME_RAD)
        )

    def observe_at(self, joints: tuple[float, ...], orientation: int) -> Any:
        self.sent_back.append(joints)
        return SimpleNamespace(orientation=orientation, joints_rad=joints)


def test_an_orientation_of_the_check_that_cannot_be_taken_gives_way_to_another_one() -> None:
    watcher: Any = Watcher()
    variants = check_variants(Rotation.identity(), BALL_MM, 0)
    assert watcher.observe(variants[0]) is None
    seen = [check_look(watcher, variants, [])]
    assert seen[0] is not None
    assert watcher.sent_back == []
    assert check_look(watcher, variants, seen) is not None
    assert watcher.sent_back == [HOME_RAD]  # the next visit is to the very same joint angles
