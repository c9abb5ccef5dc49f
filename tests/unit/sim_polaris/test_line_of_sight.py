"""Occlusion by the head, the arm and its tools."""

from __future__ import annotations

import numpy as np
import pytest

from ronna_hw.arm.clearance.bodies import Capsule
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.collision_config import CollisionConfig
from sim.polaris.measurement.line_of_sight import ArmBody, Capsules, OpaqueEllipsoid, visible
from sim.polaris.measurement.optics import EYES_MM
from sim.polaris.measurement.true_scene import UNDISTURBED, TrueScene
from sim.world.displacements import ShiftedRoom
from sim.world.nominal_arm import description
from sim.world.rigid import matrix_of
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import draw_scene
from sim.world.true_arm import JointChain
from sim.world.world import ArmState, World

EYE = np.zeros((1, 3))
LIMBS_OF_THE_ARM = 3
AS_FINE_AS_MM = 1e-6
ACROSS_THE_TUBE = "end of the guide"
BUILT_MM = 6.0  # a mount is built beside its drawing by 2 mm per axis


def stage_at_home(name: str, seed: int) -> tuple[TrueScene, World]:
    scene = draw_scene(name, seed=seed)
    world = World.create(scene, paced=False)
    joints = tuple(np.radians(scene.arm.home_deg).tolist())
    flange = JointChain(description(scene.arm.variant)).flange(joints)
    world.publish_arm(ArmState(joints, flange, 0, True))
    return TrueScene(world), world


def ball(centre: tuple[float, float, float], radius_mm: float) -> OpaqueEllipsoid:
    unit = np.diag([1.0 / radius_mm] * 3 + [1.0])
    unit[:3, 3] = -np.array(centre) / radius_mm
    return OpaqueEllipsoid(unit)


@pytest.mark.parametrize(
    ("point", "seen"),
    [
        ((0.0, 0.0, -1500.0), False),  # behind it
        ((0.0, 0.0, -800.0), True),  # before it
        ((300.0, 0.0, -1500.0), True),  # beside it
        ((130.0, 0.0, -1500.0), False),  # the line of sight cuts it
        ((0.0, 0.0, -1000.0), True),  # mounted in it
    ],
)
def test_a_ball_hides_what_is_behind_it(point: tuple[float, float, float], seen: bool) -> None:
    assert visible(EYE, np.array([point]), (ball((0.0, 0.0, -1000.0), 100.0),)).item() is seen


@pytest.mark.parametrize(
    ("point", "seen"),
    [
        ((0.0, 0.0, -1500.0), False),
        ((0.0, 0.0, -900.0), True),
        ((600.0, 0.0, -1500.0), False),  # the limb reaches from side to side
        ((0.0, 100.0, -1500.0), True),
    ],
)
def test_a_limb_hides_what_is_behind_it(point: tuple[float, float, float], seen: bool) -> None:
    limb = Capsules(np.array([[-500.0, 0.0, -1000.0]]), np.array([[500.0, 0.0, -1000.0]]), np.array([50.0]))
    assert visible(EYE, np.array([point]), (limb,)).item() is seen


def test_the_distance_of_two_segments_agrees_with_an_exhaustive_search() -> None:
    generator = np.random.default_rng(3)
    shares = np.linspace(0.0, 1.0, 200)[:, None]
    for _ in range(50):
        start, end, eye, point = generator.normal(0.0, 100.0, (4, 3))
        limb_places, ray_places = start + shares * (end - start), eye + shares * (point - eye)
        least_mm = np.linalg.norm(limb_places[:, None] - ray_places, axis=-1).min()
        for radius_mm, hidden in ((least_mm + 3.0, True), (least_mm - 3.0, False)):
            mounted = np.linalg.norm(limb_places - point, axis=1).min() < radius_mm
            if not mounted:
                limb = Capsules(start[None], end[None], np.array([radius_mm]))
                assert limb.hides(eye[None], point[None]).item() is hidden


@pytest.mark.parametrize("name", ["default", "mini"])
@pytest.mark.parametrize("seed", range(4))
def test_the_tracker_sees_head_and_frame_past_the_arm_at_home(name: str, seed: int) -> None:
    scene, world = stage_at_home(name, seed)
    arm = scene.arm()
    assert arm is not None
    frame = scene.frame(arm, UNDISTURBED)
    assert scene.is_on_mount(frame)
    past_mount = np.ones(len(frame.markers_mm), dtype=bool)
    for tool in (0, world.scene.mount.tool_number_stereo, world.scene.mount.tool_number_guide):
        assert visible(EYES_MM, scene.fiducials_mm, scene.bodies(arm, tool)).all()
        assert visible(EYES_MM, frame.markers_mm, scene.bodies(arm, tool), past_mount).all()


def test_the_mount_leaves_the_guide_axis_free_over_its_reach() -> None:
    _, world = stage_at_home("default", 0)
    mount = world.scene.mount
    flange = np.linalg.inv(matrix_of(mount.flange_from_tool_true))  # the tool's frame is the tracker's
    joints = tuple(np.radians(world.scene.arm.home_deg).tolist())
    capsules = ArmBody(world.scene).capsules(
        ArmState(joints, flange, 0, True), mount.tool_number_guide, np.eye(4)
    )
    along_axis = np.linspace((0.0, 0.0, -mount.guide.reach_mm + 20.0), (0.0, 0.0, 0.0), 50)
    side_mm = np.array([0.0, 200.0, 0.0])  # seen from beside the axis, where nothing else stands
    assert not capsules.hides((along_axis.mean(axis=0) + side_mm)[None], along_axis).any()


def test_a_tool_on_the_flange_axis_gives_finite_capsules() -> None:
    scene = draw_scene("mini", seed=4)
    pose = scene.mount.flange_from_tool_true.model_copy(update={"translation_mm": (0.0, 0.0, 60.0)})
    mount = scene.mount.model_copy(update={"flange_from_tool_true": pose})
    arm = ArmState(tuple(np.radians(scene.arm.home_deg).tolist()), np.eye(4), 0, True)
    capsules = ArmBody(scene.model_copy(update={"mount": mount})).capsules(arm, 2, np.eye(4))
    assert np.isfinite(capsules.starts_mm).all()
    assert np.isfinite(capsules.ends_mm).all()


def carried(scene: Scene, tool: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ends (n, 3) and radii (n,) of the capsules of the mount and the tool on it; tool frame."""
    flange = np.linalg.inv(matrix_of(scene.mount.flange_from_tool_true))
    arm = ArmState(tuple(np.radians(scene.arm.home_deg).tolist()), flange, 0, True)
    capsules = ArmBody(scene).capsules(arm, tool, np.eye(4))
    return tuple(one[LIMBS_OF_THE_ARM:] for one in (capsules.starts_mm, capsules.ends_mm, capsules.radii_mm))


def inside_mm(start_mm: np.ndarray, end_mm: np.ndarray, radius_mm: float) -> np.ndarray:
    """Points (n, 3) in a rod with flat ends; capsules have round ones only to compute sight easily."""
    across = np.linalg.svd((end_mm - start_mm)[None])[2][1:]
    angles = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1) @ across
    places = start_mm + np.linspace(0.0, 1.0, 100)[:, None] * (end_mm - start_mm)
    radii_mm = np.linspace(0.0, radius_mm, 9)[:, None, None, None]
    return np.asarray((places[:, None] + radii_mm * ring).reshape(-1, 3))


def beyond_mm(places_mm: np.ndarray, capsules: list[Capsule]) -> float:
    """Largest distance of the points (n, 3) outside the capsules; not positive if all are inside."""
    nearest = np.full(len(places_mm), np.inf)
    for start_mm, end_mm, radius_mm in capsules:
        way = np.subtract(end_mm, start_mm)
        share = np.clip((places_mm - start_mm) @ way / (way @ way), 0.0, 1.0)[:, None]
        away_mm = np.linalg.norm(places_mm - start_mm - share * way, axis=1)
        nearest = np.minimum(nearest, away_mm - radius_mm)
    return float(nearest.max())


@pytest.mark.hazard(24)
@pytest.mark.parametrize("tool", ["stereo", "guide"])
def test_the_planners_bodies_cover_every_body_of_the_simulated_mount(tool: str) -> None:
    scene = draw_scene("mini", seed=4)
    mount = scene.mount.model_copy(update={"flange_from_tool_true": scene.mount.flange_from_tool_nominal})
    scene = scene.model_copy(update={"mount": mount})  # as drawn; the margin covers how it was built
    cell = CollisionConfig()
    number = {"stereo": mount.tool_number_stereo, "guide": mount.tool_number_guide}[tool]
    wrist, flange = ((-220.0, 0.0, z_mm) for z_mm in (-140.0, -60.0))
    known = [one.capsule for one in {"stereo": cell.stereo_head, "guide": cell.guide}[tool]]
    known.append(Capsule(wrist, flange, kr6_r900().radii.hand_mm))
    outside_mm = [beyond_mm(inside_mm(*body), known) for body in zip(*carried(scene, number), strict=True)]
    assert max(outside_mm) <= AS_FINE_AS_MM, outside_mm


def test_every_guide_body_of_the_planner_lies_on_a_simulated_one() -> None:
    scene = draw_scene("mini", seed=4)
    starts_mm, ends_mm, _ = carried(scene, scene.mount.tool_number_guide)
    shares = np.linspace(0.0, 1.0, 200)[:, None, None]
    places = (starts_mm + shares * (ends_mm - starts_mm)).reshape(-1, 3)
    for body in CollisionConfig().guide:
        if body.name == ACROSS_THE_TUBE:
            continue
        for end in (body.start_mm, body.end_mm):
            assert np.linalg.norm(places - np.array(end), axis=1).min() <= BUILT_MM, body.name


def test_a_sphere_behind_the_head_is_not_seen() -> None:
    scene, world = stage_at_home("default", 0)
    head = world.scene.head
    centre = matrix_of(head.robot_from_ct) @ [*head.centre_ct_mm, 1.0]
    in_tracker = np.linalg.inv(matrix_of(world.scene.tracker.robot_from_tracker)) @ centre
    far_side = in_tracker[:3] * (1.0 + 120.0 / np.linalg.norm(in_tracker[:3]))
    assert not visible(EYES_MM, far_side[None], scene.bodies(None, 0)).any()


def test_an_arm_that_reaches_over_the_head_hides_spheres() -> None:
    scene, world = stage_at_home("default", 0)
    arm = scene.arm()
    assert arm is not None
    tracker = matrix_of(world.scene.tracker.robot_from_tracker)
    towards = tracker[:3, 3] / np.linalg.norm(tracker[:3, 3])
    flange = arm.robot_from_flange.copy()
    middle = (tracker @ [*scene.fiducials_mm.mean(axis=0), 1.0])[:3]
    flange[:3, 3] = middle + 200.0 * towards
    bodies = scene.bodies(ArmState(arm.joints_rad, flange, 1, True), 1)
    assert not visible(EYES_MM, scene.fiducials_mm, bodies).all()


@pytest.mark.parametrize("interval_ms", [0.0, 4.0])
def test_a_moving_head_is_deformed_only_by_a_tracker_that_exposes_one_sphere_after_the_other(
    interval_ms: float,
) -> None:
    speed_mm_s = 100.0
    scene = draw_scene("default", seed=1)
    tracker = scene.tracker.model_copy(update={"sphere_interval_ms": interval_ms})
    world = World.create(scene.model_copy(update={"tracker": tracker}), paced=False)
    still = TrueScene(world).fiducials_mm
    world.set_fault_script(f"at 0 s: room shift head {speed_mm_s:g} 0 0 mm over 1 s")
    world.clock.sleep(0.5)
    seen = TrueScene(world).expose_fiducials(ShiftedRoom(world).now())
    later_mm = np.linalg.norm((seen - still) - (seen - still)[0], axis=1)
    expected = speed_mm_s * interval_ms / 1e3 * np.arange(len(still))
    assert later_mm == pytest.approx(expected, abs=1e-6)
