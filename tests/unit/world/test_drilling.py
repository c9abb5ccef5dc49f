"""A drill in the assistant's holder: its thrust in the true skull, and the sensor that measures it."""

from __future__ import annotations

import numpy as np
import pytest

from ronna_hw.wire.room_tasks import DRILL_HOLDER, EMPTY, REST_DRILL, TEST_WEIGHT, TURN_DRILL
from sim.world.drilling import DrilledSkull
from sim.world.force_sensor import ForceSensor, sensor_of
from sim.world.options import ArmRole
from sim.world.process import load_scene
from sim.world.rigid import apply, inverse, matrix_from, matrix_of
from sim.world.saved_world import SavedWorld
from sim.world.scene.model import Scene
from sim.world.skull import SkullTables
from sim.world.staff import Staff, TaskRefused
from sim.world.world import ArmState, World

ROLE, STOP_MM = ArmRole.ASSISTANT, 150.0
SCENE = load_scene("mini", seed=3, dual=True)
HOLDER = SCENE.holders[ROLE]


def world_with_drill(scene: Scene = SCENE) -> tuple[World, Staff]:
    world = World.create(scene, paced=False)
    world.mount_tool(scene.mount.tool_number_guide)
    staff = Staff(world, None)
    staff.work(DRILL_HOLDER, "T1", (STOP_MM,))
    return world, staff


def place_tip(world: World, below_skin_mm: float) -> None:
    """Have the assistant hold the tip of its drill below the vertex of the head."""
    drill = world.held_drill()
    assert drill is not None
    head = SCENE.head
    top_ct = np.add(head.centre_ct_mm, (0.0, 0.0, head.semi_axes_mm[2] - below_skin_mm))
    place = matrix_from(apply(matrix_of(head.robot_from_ct), top_ct), np.diag([1.0, -1.0, -1.0]))
    clamp = place @ matrix_from((0.0, 0.0, -drill.tip_mm), np.eye(3))
    flange = inverse(matrix_of(HOLDER.robot_from_base)) @ clamp @ inverse(matrix_of(HOLDER.flange_from_clamp))
    world.publish_arm(ArmState((0.0,) * 6, flange, 1, True), ROLE)


def test_a_drill_meets_the_skull_where_it_truly_is() -> None:
    world, _ = world_with_drill()
    skull, outside_mm = DrilledSkull(world, ROLE), SkullTables.of().outside_mm
    place_tip(world, outside_mm - 0.2)
    assert skull.thrust_N() == 0.0
    place_tip(world, outside_mm + 0.2)
    assert skull.thrust_N() == pytest.approx(8.0, abs=0.2)


def test_only_a_drill_that_turns_cuts_and_its_opening_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    world, staff = world_with_drill()
    skull, now_ns = DrilledSkull(world, ROLE), [0]
    monkeypatch.setattr(world.clock, "now_ns", lambda: now_ns[0])
    place_tip(world, SkullTables.of().outside_mm + 0.2)
    pressed_N = [skull.thrust_N() for _ in range(3)]
    staff.work(TURN_DRILL, "T1", ())
    for _ in range(300):
        now_ns[0] += 4_000_000
        cut_N = skull.thrust_N()
    assert cut_N < 0.5 * pressed_N[-1]
    saved = SavedWorld.from_world(world)
    assert saved.drill == ("T1", pytest.approx(STOP_MM, abs=0.2), True)
    assert saved.restore(SCENE, paced=False).opening() == world.opening()
    staff.work(REST_DRILL, "T1", ())
    staff.work(EMPTY, "T1", ())
    assert skull.thrust_N() == 0.0
    with pytest.raises(TaskRefused, match="no drill"):
        staff.work(TURN_DRILL, "T1", ())


def test_the_simulator_of_the_assistant_knows_what_is_wrong_with_bone_and_drill() -> None:
    world, staff = world_with_drill()
    staff.work(TURN_DRILL, "T1", ())
    world.set_fault_script("at 0 s: room bone thicker -3 mm\nat 0 s: room drill stalls")
    place_tip(world, SkullTables.of().inside_mm)
    DrilledSkull(World.open(world.endpoint, ROLE), ROLE).thrust_N()
    assert world.opening().beyond_mm == pytest.approx(3.0, abs=0.01)
    assert world.opening().bottom_mm == pytest.approx(SkullTables.of().outside_mm)


def test_a_sensor_shows_the_thrust_with_its_errors_and_repeats_itself_when_dead() -> None:
    world, _ = world_with_drill()
    sensor = sensor_of(world, ROLE)
    assert isinstance(sensor, ForceSensor)
    assert sensor_of(world, ArmRole.MASTER) is None
    place_tip(world, 0.0)
    at_rest = np.mean([sensor.read(cycle) for cycle in range(400)], axis=0)
    place_tip(world, SkullTables.of().outside_mm + 0.5)
    change = np.mean([sensor.read(cycle) for cycle in range(400, 800)], axis=0) - at_rest
    along = -matrix_of(HOLDER.flange_from_clamp)[:3, 2]
    assert change[:3] @ along == pytest.approx(20.0, rel=0.02)
    assert np.linalg.norm(change[:3] - (change[:3] @ along) * along) < 1.0
    assert sensor.read(801, is_dead=True) == sensor.read(802, is_dead=True)


@pytest.mark.hazard(66)
@pytest.mark.parametrize(("friction", "along_N"), [(0.0, 4.0), (0.2, 4.0 + 0.2 * 6.32)])
def test_a_sensor_shows_what_presses_the_drill_aside_in_the_bone_across_its_axis_and_its_friction_along_it(
    friction: float, along_N: float
) -> None:
    assert SCENE.assistant is not None
    assistant = SCENE.assistant.model_copy(update={"drill_friction": friction})
    world, _ = world_with_drill(SCENE.model_copy(update={"assistant": assistant}))
    world.set_fault_script("at 0 s: room drill pushed aside 6 -2 N")
    sensor = ForceSensor(world, ROLE)
    place_tip(world, 0.0)
    before = np.mean([sensor.read(cycle) for cycle in range(400)], axis=0)
    place_tip(world, SkullTables.of().outside_mm + 0.1)
    change = np.mean([sensor.read(cycle) for cycle in range(400, 800)], axis=0) - before
    clamp = matrix_of(HOLDER.flange_from_clamp)[:3, :3]
    np.testing.assert_allclose(clamp.T @ change[:3], [6.0, -2.0, -along_N], atol=0.4)


def test_a_test_weight_pulls_straight_down_by_the_scale_of_the_sensor_until_it_is_taken_off() -> None:
    assert SCENE.assistant is not None
    assert SCENE.assistant.force_sensor is not None
    half = SCENE.assistant.force_sensor.model_copy(update={"scale": 0.5, "noise_N": 0.0})
    assistant = SCENE.assistant.model_copy(update={"force_sensor": half})
    world = World.create(SCENE.model_copy(update={"assistant": assistant}), paced=False)
    world.mount_tool(SCENE.mount.tool_number_guide)
    staff = Staff(world, None)
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # base <- flange: x is down
    flange = matrix_from((500.0, 0.0, 800.0), turn)
    world.publish_arm(ArmState((0.0,) * 6, flange, 1, True), ROLE)
    sensor = ForceSensor(world, ROLE)
    before = np.array(sensor.read(0))
    staff.work(TEST_WEIGHT, "T1", (2.0,))
    np.testing.assert_allclose(np.array(sensor.read(1))[:3] - before[:3], [9.81, 0.0, 0.0], atol=0.3)
    assert SavedWorld.from_world(world).restore(SCENE, paced=False).hung_kg() == 2.0
    staff.work(TEST_WEIGHT, "T1", (0.0,))
    np.testing.assert_allclose(sensor.read(2), before, atol=1e-3)
    with pytest.raises(TaskRefused, match="no test weight of 20 kg"):
        staff.work(TEST_WEIGHT, "T1", (20.0,))
