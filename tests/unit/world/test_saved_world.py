"""A saved world, continued by another theatre."""

from __future__ import annotations

from math import degrees
from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises

from sim.errors import BAD_SAVED_WORLD, THEATRE_RUNNING
from sim.kuka.controller_parameters import ControllerParameters
from sim.kuka.manipulator import Manipulator
from sim.world import saved_world
from sim.world.displacements import RoomShift, ShiftedRoom
from sim.world.faults import FaultBoard
from sim.world.saved_world import WORLD_FILE, lock_folder, read_saved_world, save_world
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World


@pytest.fixture
def scene() -> Scene:
    return draw_scene("mini", seed=3)


def moved(scene: Scene, world: World) -> Manipulator:
    """An arm of that world that has moved and come to rest."""
    arm = Manipulator(scene.arm, scene.seed, world.publish_arm, ControllerParameters())
    goal_deg = [angle + 3.0 for angle in arm.axes_deg]
    for _ in range(2000):
        arm.follow(goal_deg, has_reply=True)
    return arm


def continued(world: World, folder: Path) -> World:
    """The world of a theatre that continues this one."""
    save_world(world, folder)
    return read_saved_world(folder).restore(world.scene, paced=False)


def test_arm_tool_and_time_continue_from_where_they_were_left(scene: Scene, tmp_path: Path) -> None:
    world = World.create(scene, paced=False)
    before = moved(scene, world)
    world.mount_tool(2)
    world.clock.sleep(12.5)
    again = continued(world, tmp_path)
    after = Manipulator(scene.arm, scene.seed, again.publish_arm, ControllerParameters(), again.arm())
    assert (again.clock.now_s(), again.mounted_tool(), again.mountings()) == (12.5, 2, 1)
    assert after.axes_deg == pytest.approx(before.axes_deg, abs=1e-12)
    np.testing.assert_allclose(again.arm().robot_from_flange, world.arm().robot_from_flange, atol=1e-9)
    assert again.arm().motion_number == world.arm().motion_number
    assert degrees(again.arm().joints_rad[0]) == pytest.approx(scene.arm.home_deg[0] + 3.0)


def test_lasting_changes_persist_and_occlusions_and_pushes_end(scene: Scene, tmp_path: Path) -> None:
    world = World.create(scene, paced=False)
    world.clock.sleep(10.0)
    lines = (
        "at 3 s: room shift head 0 0.5 0 mm",
        "at 4 s: camera twist left +0.2 deg for 20 s",
        "at 5 s: room push guide 10 0 0 N",
        "at 6 s: tracker occlude tool robot_frame",
        "at 99 s: room loosen marker 2 1 0 0 mm",
    )
    world.set_fault_script("\n".join(lines))
    again = continued(world, tmp_path)
    assert ShiftedRoom(again).now() == RoomShift(head_mm=(0.0, 0.5, 0.0))
    (twist,) = FaultBoard(again, "camera").acting()
    assert (twist.kind.name, twist.duration_s) == ("twist", pytest.approx(14.0))
    assert FaultBoard(again, "tracker").empty


def test_a_rolling_cart_continues_from_its_current_position(scene: Scene, tmp_path: Path) -> None:
    world = World.create(scene, paced=False)
    world.set_fault_script("at 0 s: room unlocked cart 0 6 0 mm per min")
    world.clock.advance_cycle(30_000_000_000)
    again = continued(world, tmp_path)
    assert ShiftedRoom(again).now().head_mm == pytest.approx((0.0, -3.0, 0.0))
    again.clock.advance_cycle(10_000_000_000)
    assert ShiftedRoom(again).now().head_mm == pytest.approx((0.0, -4.0, 0.0))


def test_a_cart_wheeled_twice_continues_where_it_stands_whichever_line_came_first(
    scene: Scene, tmp_path: Path
) -> None:
    world = World.create(scene, paced=False)
    world.set_fault_script(
        "at 20 s: room move cart 1 100 0 0 mm 0 deg in 1 s\nat 10 s: room move cart 1 0 0 0 mm 90 deg in 1 s"
    )
    world.clock.sleep(30.0)
    again = ShiftedRoom(continued(world, tmp_path)).now()
    assert again.head_mm == pytest.approx(ShiftedRoom(world).now().head_mm)
    assert again.head_mm == pytest.approx((-100.0, 0.0, 0.0))


def test_a_body_that_creeps_continues_from_where_it_is_and_arrives(scene: Scene, tmp_path: Path) -> None:
    world = World.create(scene, paced=False)
    world.set_fault_script(
        "at 10 s: room shift head 2 0 0 mm over 20 s\nat 0 s: room push guide 8 0 0 N over 5 s"
    )
    world.clock.sleep(15.0)
    again = continued(world, tmp_path)
    for now_s, moved_mm in ((15.0, 0.5), (25.0, 1.5), (99.0, 2.0)):
        again.clock.sleep(now_s - again.clock.now_s())
        now = ShiftedRoom(again).now()
        assert (now.head_mm, now.guide_mm) == (pytest.approx((moved_mm, 0.0, 0.0)), (0.0, 0.0, 0.0))


@pytest.mark.parametrize("inserted", ["T1", None])
def test_an_instrument_stays_in_the_guide_of_a_continued_world(
    scene: Scene, tmp_path: Path, inserted: str | None
) -> None:
    world = World.create(scene, paced=False)
    world.put_in_guide(inserted)
    assert continued(world, tmp_path).inserted() == inserted


def test_a_folder_in_which_no_theatre_has_run_has_no_saved_world(tmp_path: Path) -> None:
    with raises(BAD_SAVED_WORLD, match=r"SIM-012: .* has no world\.json"):
        read_saved_world(tmp_path)


def test_an_invalid_saved_world_is_refused(tmp_path: Path) -> None:
    (tmp_path / WORLD_FILE).write_text('{"theatre_time_ns": -1}')
    with raises(BAD_SAVED_WORLD, match="SIM-012") as refused:
        read_saved_world(tmp_path)
    assert str(tmp_path / WORLD_FILE) in refused.value.what
    assert "Put the file back" in refused.value.advice


def test_a_folder_serves_one_theatre_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(saved_world, "END_LIMIT_S", 0.05)
    with lock_folder(tmp_path), raises(THEATRE_RUNNING, match="SIM-013"), lock_folder(tmp_path):
        pass
    with lock_folder(tmp_path):
        pass
