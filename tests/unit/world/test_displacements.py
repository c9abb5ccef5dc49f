"""Displaced heads, carts and guides, and spheres refitted in the theatre."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim.world.displacements import NOTHING_MOVED, RoomShift, ShiftedRoom, rigid_move, spheres_in_theatre
from sim.world.options import ArmRole
from sim.world.rigid import apply, inverse, matrix_of, rotation_from_vector, vector_from_rotation
from sim.world.scene.assistant import add_assistant
from sim.world.scene.model import SEATING_ERROR_MM, Scene
from sim.world.scene.named_scenes import draw_scene
from sim.world.truth import TrueGuide, sample_instrument
from sim.world.world import World


def room(script: str) -> tuple[World, RoomShift]:
    world = World.create(draw_scene("mini"), paced=False)
    world.set_fault_script(script)
    return world, ShiftedRoom(world).now()


def test_a_rotation_gives_back_its_vector() -> None:
    for vector in ([0.0, 0.0, 0.0], [0.01, -0.02, 0.005], [1.0, 2.0, -0.5]):
        assert vector_from_rotation(rotation_from_vector(vector)) == pytest.approx(
            np.array(vector), abs=1e-12
        )


def test_a_head_turns_about_its_centre() -> None:
    world, now = room("at 0 s: room turn head 0 0 1 deg")
    head = world.scene.head
    centre_mm = apply(matrix_of(head.robot_from_ct), head.centre_ct_mm)
    aside_mm = np.add(centre_mm, (100.0, 0.0, 0.0))
    moved = now.displace_spheres_mm(np.array([centre_mm, aside_mm]), (1, 2))
    assert moved[0] == pytest.approx(centre_mm)
    turned = 100.0 * np.array([math.cos(math.radians(1.0)), math.sin(math.radians(1.0)), 0.0])
    assert moved[1] - centre_mm == pytest.approx(turned)
    assert now.tracker_rad == (0.0, 0.0, 0.0)


def test_a_head_that_slips_leaves_its_clamp_where_a_moved_head_takes_it_along() -> None:
    moved = np.eye(4)
    moved[:3, 3] = (0.0, 2.0, 0.0)
    _, both = room("at 0 s: room shift head 0 2 0 mm\nat 0 s: room shift slipping_head 1 0 0 mm")
    assert rigid_move(both.head_rad, both.head_mm)[:3, 3] == pytest.approx((1.0, 2.0, 0.0))
    assert both.move_of_clamp() == pytest.approx(moved)
    _, turned = room("at 0 s: room turn slipping_head 0 0 1 deg")
    assert turned.head_rad == pytest.approx((0.0, 0.0, math.radians(1.0)))
    assert turned.move_of_clamp() == pytest.approx(np.eye(4), abs=1e-9)


def test_a_cart_that_turns_leaves_head_and_tracker_to_each_other() -> None:
    world, now = room("at 0 s: room turn cart 0.3 -0.5 0.8 deg\nat 0 s: room shift cart 1 2 3 mm")
    robot_from_tracker = matrix_of(world.scene.tracker.robot_from_tracker)
    spheres_mm = apply(
        matrix_of(world.scene.head.robot_from_ct), [one.centre_ct_mm for one in world.scene.head.fiducials]
    )
    before = apply(inverse(robot_from_tracker), spheres_mm)
    moved = rigid_move(now.tracker_rad, now.tracker_mm) @ robot_from_tracker
    after = apply(inverse(moved), now.displace_spheres_mm(spheres_mm, (1, 2, 3)))
    assert after == pytest.approx(before, abs=1e-9)
    assert np.linalg.norm(np.subtract(now.displace_spheres_mm(spheres_mm, (1, 2, 3)), spheres_mm)) > 5.0


def test_the_assistant_s_cart_rolls_along_its_own_axes_and_nothing_else_moves() -> None:
    world = World.create(add_assistant(draw_scene("mini")), paced=False)
    world.set_fault_script("at 0 s: room move cart 2 10 0 0 mm 0 deg in 0 s")
    room = ShiftedRoom(world)
    base = matrix_of(world.scene.assistant.robot_from_base)
    moved = room.robot_from_base(ArmRole.ASSISTANT, room.now())
    assert moved[:3, 3] - base[:3, 3] == pytest.approx(10.0 * base[:3, 0])
    assert np.linalg.norm(room.now().head_mm) == 0.0


def test_the_master_s_cart_leaves_head_and_assistant_to_each_other() -> None:
    world = World.create(add_assistant(draw_scene("mini")), paced=False)
    head = matrix_of(world.scene.head.robot_from_ct)
    room = ShiftedRoom(world)
    before = inverse(head) @ room.robot_from_base(ArmRole.ASSISTANT, room.now())
    world.set_fault_script("at 0 s: room move cart 1 10 -20 0 mm 5 deg in 0 s")
    now = room.now()
    after = inverse(rigid_move(now.head_rad, now.head_mm) @ head) @ room.robot_from_base(
        ArmRole.ASSISTANT, now
    )
    assert after == pytest.approx(before, abs=1e-9)
    assert np.linalg.norm(now.head_mm) > 20.0


def test_the_truth_follows_a_turned_head() -> None:
    world, now = room("at 0 s: room turn head 0 1 0 deg\nat 0 s: room shift head 0 0 2 mm")
    sample = sample_instrument(world, TrueGuide(world), "T1", 165.0, 0)
    assert sample.head_moved == pytest.approx(rigid_move(now.head_rad, now.head_mm))


def test_a_guide_that_turns_moves_no_head() -> None:
    _, now = room("at 0 s: room turn guide 0 0 1 deg")
    assert now == RoomShift(guide_rad=(0.0, 0.0, math.radians(1.0)))
    assert room("")[1] == NOTHING_MOVED


@pytest.mark.parametrize(
    ("fault", "moved"),
    [
        ("turn head 0 0.4 0 deg", "head_rad"),
        ("shift tracker 0 0.4 0 mm", "tracker_mm"),
        ("turn seat 0 0.4 0 deg", "seat_rad"),
        ("push guide 0 32 0 N", "guide_mm"),
    ],
)
def test_what_changes_slowly_comes_evenly_to_what_changes_at_once(fault: str, moved: str) -> None:
    _, at_once = room(f"at 0 s: room {fault}")
    world, _ = room(f"at 10 s: room {fault} over 20 s")
    for now_s, share in ((9.9, 0.0), (15.0, 0.25), (30.0, 1.0), (99.0, 1.0)):
        world.clock.sleep(now_s - world.clock.now_s())
        grown = share * np.array(getattr(at_once, moved))
        assert getattr(ShiftedRoom(world).now(), moved) == pytest.approx(grown, abs=1e-9)


def test_a_hand_leans_on_the_guide_for_a_while() -> None:
    world, _ = room("at 0 s: room push guide 80 0 0 N over 5 s for 20 s")
    pushed_mm = []
    for now_s in (2.5, 5.0, 19.9, 20.1):
        world.clock.sleep(now_s - world.clock.now_s())
        pushed_mm.append(ShiftedRoom(world).now().guide_mm[0])
    assert pushed_mm == pytest.approx([0.5, 1.0, 1.0, 0.0])  # over 80 N/mm


def test_a_tracker_turns_about_its_origin_and_an_assistant_s_cart_about_its_base() -> None:
    world = World.create(add_assistant(draw_scene("mini")), paced=False)
    assert world.scene.assistant is not None
    tracker = matrix_of(world.scene.tracker.robot_from_tracker)
    base = matrix_of(world.scene.assistant.robot_from_base)
    room = ShiftedRoom(world)
    world.set_fault_script(
        "at 0 s: room turn tracker 0 0 1 deg\nat 0 s: room turn assistant_cart 0 1 0 deg\n"
        "at 0 s: room shift assistant_cart 0 0 2 mm"
    )
    now = room.now()
    turned = rigid_move(now.tracker_rad, now.tracker_mm) @ tracker
    assert turned[:3, 3] == pytest.approx(tracker[:3, 3])
    assert vector_from_rotation(turned[:3, :3] @ tracker[:3, :3].T) == pytest.approx((0, 0, math.radians(1)))
    moved = room.robot_from_base(ArmRole.ASSISTANT, now)
    assert moved[:3, 3] - base[:3, 3] == pytest.approx((0.0, 0.0, 2.0))
    assert vector_from_rotation(moved[:3, :3] @ base[:3, :3].T) == pytest.approx((0, math.radians(1), 0))
    assert (now.head_mm, now.head_rad) == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def test_a_guide_turns_in_its_seat_about_its_tip_and_the_frame_on_the_mount_stays() -> None:
    world, _ = room("")
    guide = TrueGuide(world)
    flange = np.eye(4)
    before = guide.tip_frame(flange)
    world.set_fault_script("at 0 s: room turn seat 0 1 0 deg\nat 0 s: room shift seat 0.5 0 0 mm")
    moved = inverse(before) @ guide.tip_frame(flange)
    assert moved[:3, 3] == pytest.approx((0.5, 0.0, 0.0), abs=0.001)  # besides the seat's own play
    assert vector_from_rotation(moved[:3, :3]) == pytest.approx((0.0, math.radians(1.0), 0.0), abs=1e-9)
    assert ShiftedRoom(world).now().guide_rad == (0.0, 0.0, 0.0)


SEEDS = 40


def beside_mm(scene: Scene) -> np.ndarray:
    """Displacement (n, 3) of each sphere from its place in the CT."""
    there = np.array([one.centre_ct_mm for one in spheres_in_theatre(scene)])
    return np.asarray(there - [one.centre_ct_mm for one in scene.head.fiducials])


def with_head(scene: Scene, **changes: object) -> Scene:
    return scene.model_copy(update={"head": scene.head.model_copy(update=changes)})


def test_a_reseated_sphere_is_off_its_place_by_the_seating_error() -> None:
    scene = draw_scene("mini", markers=8)
    drawn = np.concatenate([beside_mm(scene.model_copy(update={"seed": seed})) for seed in range(SEEDS)])
    assert drawn.std(axis=0) == pytest.approx(3 * [SEATING_ERROR_MM], rel=0.15)
    assert np.abs(drawn.mean(axis=0)).max() < 4.0 * SEATING_ERROR_MM / len(drawn) ** 0.5


def test_without_seating_error_every_sphere_is_where_the_ct_shows_it() -> None:
    assert not beside_mm(with_head(draw_scene("mini"), seating_error_mm=0.0)).any()


def test_the_seating_of_a_sphere_does_not_depend_on_the_others() -> None:
    scene = draw_scene("mini", markers=5)
    fewer = with_head(scene, fiducials=scene.head.fiducials[2:])
    assert beside_mm(fewer).tolist() == beside_mm(scene)[2:].tolist()


def test_a_sphere_may_be_missing_displaced_or_on_the_base_of_another() -> None:
    scene = with_head(draw_scene("mini", markers=5), seating_error_mm=0.0)
    first, second, third, *others = scene.head.fiducials
    changed = (
        first.model_copy(update={"missing": True}),
        second.model_copy(update={"base_in_theatre": third.number, "displaced_mm": (0.0, 1.0, 0.0)}),
        third.model_copy(update={"base_in_theatre": second.number, "base_mm": 20.0, "worn_percent": 30.0}),
        *others,
    )
    two, three, *rest = spheres_in_theatre(with_head(scene, fiducials=changed))
    longer = 4.0 * np.array(second.post_ct) + (0.0, 1.0, 0.0)
    assert np.subtract(two.centre_ct_mm, second.centre_ct_mm) == pytest.approx(longer)
    shorter = -4.0 * np.array(third.post_ct)
    assert np.subtract(three.centre_ct_mm, third.centre_ct_mm) == pytest.approx(shorter)
    assert (two.worn_percent, three.worn_percent) == (30.0, 0.0)  # a film goes with its base
    assert rest == list(others)


def base_now(now: RoomShift) -> np.ndarray:
    """Pose (4, 4) of the robot's base in the base before anything moved, by the head that stays."""
    return inverse(rigid_move(now.head_rad, now.head_mm))


def test_a_wheeled_cart_moves_along_the_axes_of_the_robot_as_they_are_by_then() -> None:
    _, now = room(
        "at 0 s: room move cart 1 100 0 0 mm 90 deg in 0 s\nat 0 s: room move cart 1 50 0 0 mm 0 deg in 0 s"
    )
    assert base_now(now)[:3, 3] == pytest.approx((100.0, 50.0, 0.0))
    assert now.tracker_rad == pytest.approx((0.0, 0.0, -math.pi / 2.0))
    assert now.head_mm == pytest.approx(now.tracker_mm)
    assert now.head_rad == pytest.approx(now.tracker_rad)


def test_a_cart_moves_in_the_order_of_time_whichever_line_comes_first() -> None:
    moves = (
        "at 60 s: room move cart 1 100 0 0 mm 0 deg in 1 s",
        "at 10 s: room move cart 1 0 0 0 mm 90 deg in 1 s",
    )
    for script in ("\n".join(moves), "\n".join(reversed(moves))):
        world, _ = room(script)
        world.clock.sleep(99.0)
        assert base_now(ShiftedRoom(world).now())[:3, 3] == pytest.approx((0.0, 100.0, 0.0))


def test_a_cart_rolls_evenly_until_it_has_arrived() -> None:
    world, _ = room("at 1 s: room move cart 1 40 0 0 mm 4 deg in 2 s")
    for now_s, share in ((1.0, 0.0), (1.5, 0.25), (3.0, 1.0), (9.0, 1.0)):
        world.clock.sleep(now_s - world.clock.now_s())
        base = base_now(ShiftedRoom(world).now())
        assert base[0, 3] == pytest.approx(40.0 * share)
        assert math.degrees(math.atan2(base[1, 0], base[0, 0])) == pytest.approx(4.0 * share)


def test_a_loosened_sphere_stays_beside_its_screw_when_the_cart_turns() -> None:
    loose = "at 0 s: room loosen marker 1 0 2 0 mm"
    _, before = room(loose)
    _, now = room(f"{loose}\nat 0 s: room move cart 1 30 0 0 mm 60 deg in 0 s")
    places = np.zeros((1, 3))
    seen_by_robot = apply(base_now(now), now.displace_spheres_mm(places, (1,)))
    assert seen_by_robot == pytest.approx(before.displace_spheres_mm(places, (1,)))
