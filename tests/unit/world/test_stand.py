"""The calibration stand: the head sees its ball, and its dials show the offset of the guide's tip."""

from __future__ import annotations

import numpy as np
import pytest

from sim.basler.camera.view import View
from sim.errors import StandNotReady
from sim.world.control import Room
from sim.world.on_stand import OnStand
from sim.world.rigid import inverse, matrix_from, matrix_of, rotation_from_vector
from sim.world.scene.named_scenes import named_scene
from sim.world.stand import read_dials
from sim.world.true_guide import TrueGuide, calibrated_tip
from sim.world.world import ArmState, World

JOINTS = (0.0,) * 6


@pytest.fixture
def world() -> World:
    """A world in which the guide's tip is on the stand, turned somehow."""
    world = World.create(named_scene("mini", seed=3), paced=False)
    world.mount_tool(world.scene.mount.tool_number_guide)
    world.put_on_stand(OnStand.DIVOT)
    bring_tip(world, (0.0, 0.0, 0.0))
    return world


def bring_tip(world: World, beside_mm: tuple[float, float, float]) -> None:
    scene = world.scene
    place = np.array(scene.stand.ball_mm) + scene.stand.divot_from_ball_mm + beside_mm
    tip = matrix_from(place, rotation_from_vector((0.3, 2.9, 0.2)))
    world.publish_arm(ArmState(JOINTS, np.eye(4), 1, True))
    flange = tip @ inverse(TrueGuide(world).tip_frame())  # of the guide as it is seated
    world.publish_arm(ArmState(JOINTS, flange, 1, True))


def test_the_dials_read_zero_at_the_place_of_the_ball(world: World) -> None:
    assert np.allclose(read_dials(world), 0.0, atol=0.02)


def test_the_dials_show_the_tip_offset_along_their_own_axes(world: World) -> None:
    beside = (1.0, -2.0, 0.5)
    bring_tip(world, beside)
    read = read_dials(world)
    turned = rotation_from_vector(world.scene.stand.dials_turned_rad).T @ beside
    assert np.allclose(read, turned, atol=0.02)
    assert all(round(value, 2) == pytest.approx(value) for value in read)


@pytest.mark.parametrize(
    ("fault", "off_mm"),
    [
        ("bent tip 1 0 0 mm", 1.0),
        ("wrong mandrel 3 mm", 3.0),
        ("bad seat 0.5 mm 0 deg", 0.5),
        ("push guide 80 0 0 N", 1.0),  # over 80 N/mm
        ("wrong load 2 kg", 0.3),
    ],
)
def test_the_dials_show_how_far_a_fault_displaces_the_end_of_the_mandrel(
    world: World, fault: str, off_mm: float
) -> None:
    world.set_fault_script(f"at 0 s: room {fault}")
    assert np.linalg.norm(read_dials(world)) == pytest.approx(off_mm, abs=0.02)


def test_the_dials_show_a_guide_that_the_scene_says_is_bent() -> None:
    scene = named_scene("mini", seed=3)
    bent = scene.mount.guide.model_copy(update={"bent_mm": (1.0, 0.0, 0.0)})
    read = []
    for mount in (scene.mount, scene.mount.model_copy(update={"guide": bent})):
        world = World.create(scene.model_copy(update={"mount": mount}), paced=False)
        world.mount_tool(mount.tool_number_guide)
        world.put_on_stand(OnStand.DIVOT)
        flange = matrix_from(scene.stand.ball_mm, np.eye(3)) @ inverse(calibrated_tip(world))
        world.publish_arm(ArmState(JOINTS, flange, 1, True))
        read.append(read_dials(world))
    assert np.linalg.norm(np.subtract(*read)) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("what", ["too far", "no divot", "stereo head"])
def test_dials_that_cannot_be_read_are_refused(world: World, what: str) -> None:
    if what == "too far":
        bring_tip(world, (0.0, 0.0, 7.0))
    elif what == "no divot":
        world.put_on_stand(OnStand.BALL)
    else:
        world.mount_tool(world.scene.mount.tool_number_stereo)
    with pytest.raises(StandNotReady, match="SIM-015"):
        read_dials(world)


def test_the_control_port_moves_the_stand_and_reads_it(world: World) -> None:
    room = Room(world, None)
    assert room.answer({"do": "work", "task": "dials"})["readings"] == list(read_dials(world))
    assert room.answer({"do": "stand", "holds": "ball"})["ok"]
    assert world.on_stand() is OnStand.BALL
    assert not room.answer({"do": "stand", "holds": "cup"})["ok"]
    assert "the divot is not on the stand" in room.answer({"do": "work", "task": "dials"})["reason"]


def test_the_head_sees_the_ball_only_while_it_is_on_the_stand(world: World) -> None:
    view = View(world, world.scene.left)
    world.mount_tool(world.scene.mount.tool_number_stereo)
    over = matrix_from(world.scene.stand.ball_mm, rotation_from_vector((np.pi, 0.0, 0.0)))
    without = view.spheres(over)
    world.put_on_stand(OnStand.BALL)
    (ball,) = [one for one in view.spheres(over) if one.number not in {each.number for each in without}]
    assert np.allclose(ball.centre_mm, matrix_of(world.scene.left.camera_from_tool)[:3, 3], atol=1e-6)
