"""Obstacles the arm keeps clear of: the x-shaped frame, not only its spheres, and with a reserve."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.plan_model import FiducialKind
from procedures.planning.scene import PlanningScene, build_frame_bodies
from procedures.registration.errors import LayoutNotFound
from ronna_hw.collision_config import CollisionConfig
from ronna_hw.frames import Frame, Transform
from ronna_hw.x_frame import BAR_BELOW_MM, SPHERE_CENTRES_MM

PLACE = RigidTransform.from_components([10.0, -20.0, 90.0], Rotation.from_rotvec([0.3, -0.2, 0.8]))
SPHERES_MM = PLACE.apply(SPHERE_CENTRES_MM)
HEAD = HeadEllipsoid(centre_mm=(0.0, 0.0, 0.0), semi_axes_mm=(75.0, 95.0, 90.0))
ROBOT_FROM_CT = Transform(Frame.ROBOT, Frame.CT, RigidTransform.from_translation([700.0, 0.0, 200.0]))
FLANGE_FROM_TOOL = Transform.of(Frame.FLANGE, Frame.TOOL)


@pytest.mark.hazard(24)
def test_the_frames_bars_and_foot_are_obstacles_where_the_ct_shows_its_spheres() -> None:
    frame = build_frame_bodies(FiducialKind.XFRAME, SPHERES_MM[[2, 0, 3, 1]])
    scene = PlanningScene(CollisionConfig(), HEAD, tuple(map(tuple, SPHERES_MM.tolist())), frame)
    around = scene.with_guide(ROBOT_FROM_CT, FLANGE_FROM_TOOL, None)
    bars = {one.name: one.capsule for one in around.obstacles if "frame" in one.name}
    assert list(bars) == ["bar 1 of the frame", "bar 2 of the frame", "foot of the frame"]
    below = PLACE.rotation.apply([0.0, 0.0, -BAR_BELOW_MM])
    wanted = ROBOT_FROM_CT.apply(SPHERES_MM[[1, 3]] + below)
    bar = bars["bar 2 of the frame"]
    assert np.array([bar.start_mm, bar.end_mm]) == pytest.approx(wanted)


def test_free_spheres_add_no_obstacles_and_an_incomplete_frame_is_refused() -> None:
    assert build_frame_bodies(FiducialKind.FREE, SPHERES_MM) == ()
    with pytest.raises(LayoutNotFound):
        build_frame_bodies(FiducialKind.XFRAME, SPHERES_MM[:3])


@pytest.mark.hazard(24)
def test_the_reserve_for_the_mount_is_added_to_the_clearance_of_the_stereo_head() -> None:
    scene = PlanningScene(CollisionConfig(), HEAD)
    plain, reserved = (
        one.with_stereo_head(ROBOT_FROM_CT, FLANGE_FROM_TOOL) for one in (scene, scene.with_reserve(2.0))
    )
    assert reserved.margin_mm == plain.margin_mm + 2.0
    assert reserved.obstacles == plain.obstacles
    guide = scene.with_reserve(2.0).with_guide(ROBOT_FROM_CT, FLANGE_FROM_TOOL, None)
    assert guide.margin_mm == plain.margin_mm
