"""A position of the cart is judged as the path check judges it, with what the cart moves against the head."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from half_sitting import SIGHT, arm_setting, reclined_ct
from scipy.spatial.transform import RigidTransform, Rotation

from benchmarks.place_map import agreement, cart_case
from drivers.ndi_polaris.measuring_volume import PUBLISHED_VOLUMES
from procedures.planning.cart_place import CartCase, CartMove, PlaceSolution
from procedures.planning.free_angle import choose_free_angles
from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.line_of_sight import StereoSight
from procedures.planning.pose_name import GAUGE
from procedures.planning.scene import PlanningScene
from procedures.planning.visits import ArmSetting, Axes, build_target_visit, list_localizations
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.pose import radians6
from ronna_hw.collision_config import BodyFrame, CollisionConfig, RoomBody
from ronna_hw.devices.crossed_sight import SENSORS_MM
from ronna_hw.devices.sensors import VolumeSections
from ronna_hw.frames import Frame, Transform
from ronna_hw.wire.polaris import PolarisModel

HEAD = HeadEllipsoid(centre_mm=(0.0, 0.0, 0.0), semi_axes_mm=(78.0, 98.0, 93.0))
SPECTRA, VICRA = PUBLISHED_VOLUMES[PolarisModel.SPECTRA], PUBLISHED_VOLUMES[PolarisModel.VICRA]
FIDUCIALS = ((-23.0, -68.0, 68.0), (61.0, -33.0, 68.0), (2.0, -18.0, 103.0))
ALONG = Trajectory("T1", (7.0, -70.0, 60.0), (2.0, -28.0, 26.0)).with_rest(0.7)
HERE, PLANNED = CartMove(0.0, 0.0), (("T1", 0.0),)
# The frame on the arm, which faces up at home, and a usual direction from there to the tracker.
ON_ARM = Transform.of(
    Frame.TOOL, Frame.MARKER, translation_mm=(-150.0, 0.0, -140.0), quaternion_wxyz=(0.0, 1.0, 0.0, 0.0)
)
ABOVE = (500.0, 900.0, 1300.0)


def _setting(*bodies: RoomBody) -> ArmSetting:
    cell = CollisionConfig(bodies=(*CollisionConfig().bodies, *bodies))
    return arm_setting(reclined_ct(HEAD.centre_mm), scene=PlanningScene(cell, HEAD, FIDUCIALS))


def _case(setting: ArmSetting, sight: StereoSight = SIGHT, tracker: Transform | None = None) -> CartCase:
    return CartCase(setting, (ALONG,), FIDUCIALS, sight, tracker, ON_ARM, SPECTRA.sections_mm)


def _looking_at_the_arm(setting: ArmSetting, way: tuple[float, float, float], far_mm: float) -> Transform:
    """A tracker so far from the frame on the arm at home, in that direction, turned to it."""
    home = setting.kinematics.flange_pose(setting.start_rad)
    z = np.array(way) / np.linalg.norm(way)
    x = np.cross([0.0, 1.0, 0.0], z) / np.linalg.norm(np.cross([0.0, 1.0, 0.0], z))
    turned = Rotation.from_matrix(np.column_stack([x, np.cross(z, x), z]))
    place_mm = (home @ setting.flange_from_tool @ ON_ARM).translation_mm + far_mm * z
    return Transform(Frame.ROBOT, Frame.TRACKER, RigidTransform.from_components(place_mm, turned))


def _known() -> PlaceSolution:
    """How the assumed position serves: at the planned angle."""
    found = _case(_setting()).judge(HERE).found
    assert found is not None
    assert found.turns_rad == PLANNED
    return found


def _pushed(setting: ArmSetting, move: CartMove) -> ArmSetting:
    """The head as it lies for a cart that was pushed and then turned."""
    back = Rotation.from_rotvec([0.0, 0.0, -move.turn_rad])
    origin_mm = back.apply(setting.robot_from_ct.translation_mm - [move.x_mm, move.y_mm, 0.0])
    at = RigidTransform.from_components(origin_mm, back * setting.robot_from_ct.rigid.rotation)
    return replace(setting, robot_from_ct=Transform(Frame.ROBOT, Frame.CT, at))


def test_a_cart_is_pushed_and_then_turned() -> None:
    seen = CartMove(100.0, 0.0, math.pi / 2.0).to_cart_frame(
        RigidTransform.from_translation([300.0, 0.0, 50.0])
    )
    assert seen.apply([0.0, 0.0, 0.0]) == pytest.approx([0.0, -200.0, 50.0])


@pytest.mark.hazard(48)
@pytest.mark.parametrize("places", [4, pytest.param(20, marks=pytest.mark.slow)])
def test_a_position_serves_exactly_where_the_path_check_passes(places: int) -> None:
    setting, known = _setting(), _known()
    random = np.random.default_rng(1).uniform((-320.0, -150.0, -0.2), (-80.0, 150.0, 0.2), (places, 3))
    moves = [CartMove(*numbers) for numbers in random.tolist()]
    passes = [
        choose_free_angles(_pushed(setting, move), (ALONG,), FIDUCIALS, SIGHT).check.passed for move in moves
    ]
    assert [_case(setting).judge(move, (known,)).serves for move in moves] == passes
    assert places / 4 <= sum(passes) <= places * 3 / 4


@pytest.mark.hazard(48)
def test_a_position_from_which_the_guide_cannot_go_to_its_gauge_is_refused_by_map_and_path_check() -> None:
    free = replace(_setting(), gauge_rad=radians6(-40.0, -75.0, 99.0, 0.0, 66.0, 180.0))
    assert _case(free).judge(HERE, (_known(),)).serves
    tip = free.kinematics.flange_pose(free.gauge_rad or free.start_rad) @ free.flange_from_tool
    x, y, z = tip.apply([0.0, 0.0, -130.0]).tolist()  # beside the guide
    lamp = RoomBody(name="lamp", start_mm=(x, y, z), end_mm=(x, y, z), radius_mm=15.0, frame=BodyFrame.ROBOT)
    assert _case(_setting(lamp)).judge(HERE, (_known(),)).serves  # it is in no other way
    setting = replace(_setting(lamp), gauge_rad=free.gauge_rad)
    refused = _case(setting).judge(HERE, (_known(),))
    assert (refused.serves, refused.pose) == (False, "gauge")
    assert "the lamp" in refused.reason
    check = choose_free_angles(setting, (ALONG,), FIDUCIALS, SIGHT).check
    assert [one.pose for one in check.unmet] == [GAUGE]


@pytest.mark.hazard(48)
def test_a_known_solution_that_comes_too_close_here_is_not_taken_over() -> None:
    x, y, z = build_target_visit(_setting(), ALONG).pose.apply([-130.0, 0.0, -120.0]).tolist()
    stand = RoomBody(
        name="drip stand", start_mm=(x, y, z), end_mm=(x, y, z), radius_mm=15.0, frame=BodyFrame.ROBOT
    )
    judged = _case(_setting(stand)).judge(HERE, (_known(),))
    assert judged.found is not None
    assert judged.found.turns_rad != PLANNED


@pytest.mark.hazard(48)
def test_a_known_solution_in_which_a_sphere_hides_another_is_not_taken_over() -> None:
    setting, known = _setting(), _known()
    (axis,) = Axes.of(setting, (ALONG,), FIDUCIALS).localized
    pose = list_localizations(setting, axis, FIDUCIALS, known.branch)[0].pose
    second = pose.inverse().apply(setting.robot_from_ct.apply(np.array(FIDUCIALS[1])))
    hidden = replace(SIGHT, right_mm=250.0 * second / np.linalg.norm(second))
    judged = _case(setting, hidden).judge(HERE, (known,))
    assert judged.found is not None
    assert judged.found.turns_rad != PLANNED


@pytest.mark.hazard(48)
def test_a_position_at_which_the_arm_at_home_hides_a_sphere_from_the_tracker_is_named() -> None:
    setting = _setting()
    sphere_mm = setting.robot_from_ct.apply(np.array(FIDUCIALS[0]))
    wrist_mm = setting.kinematics.flange_pose(setting.start_rad).translation_mm
    sensor_mm = sphere_mm + 5.0 * (wrist_mm - sphere_mm)  # one of both, behind the wrist
    middle_mm = sensor_mm - np.array(SENSORS_MM[0])
    tracker = Transform.of(Frame.ROBOT, Frame.TRACKER, translation_mm=middle_mm)
    case = replace(_case(setting, tracker=tracker), stereo_from_marker=None)
    hidden = case.judge(HERE, (_known(),))
    assert not hidden.serves
    assert hidden.reason.startswith("the arm at home hides fiducial 1")
    assert case.judge(CartMove(0.0, 400.0), (_known(),)).serves  # it stays where it is in the room


@pytest.mark.hazard(48)
@pytest.mark.parametrize(
    ("way", "far_mm", "said"),
    [
        (ABOVE, 1900.0, ""),
        (ABOVE, 2400.0, "the frame on the arm at home is outside the measuring volume of the tracker"),
        (ABOVE, 1000.0, "the frame on the arm at home is outside the measuring volume of the tracker"),
        ((500.0, 900.0, -100.0), 1900.0, "the frame on the arm at home faces away from the tracker"),
        ((-900.0, 0.0, 300.0), 1900.0, "the arm at home hides the frame on it from the tracker"),
    ],
)
def test_a_position_from_which_the_tracker_cannot_see_the_frame_on_the_arm_is_refused(
    way: tuple[float, float, float], far_mm: float, said: str
) -> None:
    setting = _setting()
    judged = _case(setting, tracker=_looking_at_the_arm(setting, way, far_mm)).judge(HERE, (_known(),))
    assert (judged.serves, judged.reason) == (not said, said)


@pytest.mark.parametrize(
    ("volume_mm", "serves"),
    [(PUBLISHED_VOLUMES[PolarisModel.VEGA].sections_mm, True), (VICRA.sections_mm, False), ((), True)],
)
def test_the_frame_on_the_arm_must_be_in_the_volume_of_the_tracker_that_is_there(
    volume_mm: VolumeSections, serves: bool
) -> None:
    setting = _setting()
    case = _case(setting, tracker=_looking_at_the_arm(setting, ABOVE, 1900.0))
    assert replace(case, volume_mm=volume_mm).judge(HERE, (_known(),)).serves is serves


PLACES, WITHIN_MM = 100, 240.0


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.hazard(48)
@pytest.mark.parametrize("turn_deg", [0.0, 15.0])
def test_the_path_check_refuses_no_place_of_the_map_and_few_are_lost(turn_deg: float) -> None:
    found = agreement(cart_case("mini"), PLACES, WITHIN_MM, turn_deg, workers=1)
    assert found.refused == 0
    assert found.lost <= 0.05 * PLACES
    assert 0 < found.allowed < PLACES
