"""Driving from look to look: one approach side, the way by home, the search, what stands around, no ball."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.head_looks import ENDPOINTS
from procedures.calibration.errors import NoBall, PosesOutOfReach, TooFewPoses
from procedures.calibration.pose_set import PlannedLook, calibration_looks, check_variants
from procedures.cli import stereo_ball, stereo_looks, stereo_session
from procedures.cli.stereo_ball import BallPlace, place_of_ball
from procedures.cli.stereo_looks import APPROACH_RAD, BallWatcher, surround_ball
from procedures.cli.stereo_session import check_look
from procedures.relocalization.errors import NoSphere, SphereNotInView
from procedures.steps.stereo_look import Look
from ronna_hw.arm.angles import radians6
from ronna_hw.arm.errors import NotClear
from ronna_hw.config import parse_theatre
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import EXIT_REFUSED
from sim.theatre.scene.named_scenes import built_in_scene
from sim.theatre.theatre_file import theatre_content

HOME_RAD = radians6(0.0, -75.0, 99.0, 0.0, 66.0, 180.0)
BALL_MM = np.array([720.0, -10.0, 310.0])


class Arm:
    """Goes where it is told; refuses the moves with these numbers as not clear."""

    def __init__(self, refused: tuple[int, ...] = ()) -> None:
        self.moves: list[tuple[float, ...]] = []
        self.asked = 0
        self.refused = refused
        self.around: Any = None
        self.state = Lifecycle.ACTIVE

    def move_joints(self, joints: tuple[float, ...]) -> None:
        self.asked += 1
        if self.asked in self.refused:
            raise NotClear("the way is not clear")
        self.moves.append(joints)

    def read_state(self) -> Any:
        return SimpleNamespace(joints_rad=self.moves[-1] if self.moves else HOME_RAD)

    def surround(self, around: Any) -> None:
        self.around = around


def context_with(arm: Arm) -> Any:
    theatre = parse_theatre(theatre_content(built_in_scene("mini", seed=3), ENDPOINTS, "host:", {}, 1.0))
    return SimpleNamespace(
        theatre=theatre,
        calibrations=theatre.calibration,
        devices=SimpleNamespace(arm=arm, stereo=SimpleNamespace(set_areas=lambda *_: None)),
        case=SimpleNamespace(add=lambda _kind, payload, _parents: SimpleNamespace(payload=payload)),
    )


@pytest.fixture
def nothing_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    nothing = Look(SimpleNamespace(), None, None, None, NoSphere("no sphere in view"))  # type: ignore[arg-type]
    monkeypatch.setattr(stereo_looks, "look", lambda _context: nothing)


@pytest.mark.usefixtures("nothing_seen")
def test_every_pose_is_taken_from_the_same_side_in_every_joint() -> None:
    arm = Arm()
    watcher = BallWatcher(context_with(arm), BALL_MM, HOME_RAD)
    reference = BallPlace(BALL_MM, np.empty((0, 3))).reference
    for planned in calibration_looks(reference, BALL_MM, 10):
        assert watcher.observe(planned) is None
    before, at = np.array(arm.moves[0::2]), np.array(arm.moves[1::2])
    assert len(at) == 10
    assert at - before == pytest.approx(APPROACH_RAD)
    assert watcher.rejected == {"no sphere in view": 10}


@pytest.mark.usefixtures("nothing_seen")
def test_a_way_that_is_not_clear_leads_by_home() -> None:
    arm = Arm(refused=(1,))
    watcher = BallWatcher(context_with(arm), BALL_MM, HOME_RAD)
    watcher.observe(BallPlace(BALL_MM, np.empty((0, 3))).first_look)
    assert len(arm.moves) == 3
    assert arm.moves[0] == HOME_RAD


@pytest.mark.usefixtures("nothing_seen")
def test_a_look_that_cannot_be_taken_is_counted_and_left_out() -> None:
    arm = Arm(refused=(1, 3))  # neither straight nor by way of home
    watcher = BallWatcher(context_with(arm), BALL_MM, HOME_RAD)
    first = BallPlace(BALL_MM, np.empty((0, 3))).first_look
    assert watcher.observe(first) is None
    assert watcher.rejected == {"ARM-007": 1}


@pytest.mark.usefixtures("nothing_seen")
def test_an_arm_that_tripped_is_not_taken_for_a_pose_out_of_reach() -> None:
    arm = Arm(refused=(1, 3))
    arm.state = Lifecycle.FAULT
    watcher = BallWatcher(context_with(arm), BALL_MM, HOME_RAD)
    with pytest.raises(NotClear):
        watcher.observe(BallPlace(BALL_MM, np.empty((0, 3))).first_look)


@pytest.mark.usefixtures("nothing_seen")
def test_a_ball_that_is_not_there_is_searched_for_and_refused() -> None:
    arm = Arm()
    watcher = BallWatcher(context_with(arm), BALL_MM, HOME_RAD)
    with pytest.raises(SphereNotInView, match="STE-009"):
        watcher.find(BallPlace(BALL_MM, np.empty((0, 3))).first_look)
    assert len(arm.moves) == 2 * (1 + 36)


def test_the_arm_is_told_of_ball_stand_neighbours_and_its_own_head() -> None:
    arm = Arm()
    surround_ball(context_with(arm), BALL_MM, [[700.0, 60.0, 300.0]])
    names = [obstacle.name for obstacle in arm.around.obstacles]
    assert names == ["ball's stand", "ball", "other ball 1"]
    assert {"left camera", "right camera"} <= {part.name for part in arm.around.tool}


def test_without_a_ball_that_stands_alone_nothing_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = SimpleNamespace(payload={"points_robot_mm": [[700.0, 0.0, 300.0], [710.0, 0.0, 300.0]]})
    monkeypatch.setattr(stereo_ball.global_localization, "run", lambda _context: seen)
    with pytest.raises(NoBall, match="CAL-009") as refused:
        place_of_ball(context_with(Arm()), None)
    assert refused.value.exit_code == EXIT_REFUSED


def test_the_ball_nearest_to_the_head_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [[870.0, 370.0, 1060.0], [720.0, -10.0, 318.0], [600.0, 200.0, 200.0]]
    seen = SimpleNamespace(payload={"points_robot_mm": points})
    monkeypatch.setattr(stereo_ball.global_localization, "run", lambda _context: seen)
    place = place_of_ball(context_with(Arm()), None)
    assert place.ball_mm.tolist() == points[1]
    assert place.others_mm.tolist() == [points[0], points[2]]


@pytest.mark.parametrize(
    ("reason", "error"), [("ARM-007", PosesOutOfReach), ("no sphere in view", TooFewPoses)]
)
def test_too_few_looks_are_told_by_their_commonest_reason(reason: str, error: type[Exception]) -> None:
    watcher = BallWatcher(context_with(Arm()), BALL_MM, HOME_RAD)
    watcher.rejected[reason] = 40
    with pytest.raises(error, match=f"40 x {reason}"):
        stereo_session.refuse_too_few(watcher, 30)


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
