"""Simulated staff: depth stop, instrument, cart, stand and gauge, and the faults that act on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises

from ronna_hw.frames import Frame
from ronna_hw.wire.room_tasks import (
    CART_PUSH,
    DEPTH_STOP,
    GAUGE,
    INSERT,
    MEASURE,
    SITE_MARK,
    SKIN,
    TASKS,
    TOUCH,
    OnStand,
)
from sim.basler.camera.view import View
from sim.errors import STAND_NOT_READY, BadFaultScript
from sim.world.control_port import ControlledRoom
from sim.world.displacements import ShiftedRoom
from sim.world.faults import check_faults, parse_faults
from sim.world.rigid import inverse, matrix_from, matrix_of, rotation_from_vector
from sim.world.scene.named_scenes import draw_scene
from sim.world.scene.parts import Guide
from sim.world.staff import Staff, TaskRefused, read_dials
from sim.world.truth import TrueGuide, read_samples, tip_at_calibration
from sim.world.world import ArmState, World

SCENE = draw_scene("mini", seed=3)
EXACT = SCENE.mount.guide.model_copy(update={"play_mm": 0.0, "depth_stop_mm": 0.0, "seat_mm": 0.0})
FLANGE = np.diag([1.0, -1.0, -1.0, 1.0])  # pointing down, at the robot's origin
STOP_MM = 165.0


def a_world(guide: Guide = EXACT) -> World:
    mount = SCENE.mount.model_copy(update={"guide": guide})
    world = World.create(SCENE.model_copy(update={"mount": mount}), paced=False)
    world.publish_arm(ArmState((0.0,) * 6, FLANGE, 1, True))
    world.mount_tool(mount.tool_number_guide)
    return world


def tip_mm(world: World, folder: Path) -> np.ndarray:
    staff = Staff(world, folder)
    staff.work(DEPTH_STOP, "T1", (STOP_MM,))
    staff.work(INSERT, "T1", ())
    return np.array(read_samples(folder)[-1].tip_mm)


def planned_mm() -> np.ndarray:
    """Point on the axis of the bore at the depth of the stop."""
    tip = FLANGE @ matrix_of(SCENE.mount.flange_from_tool_true) @ matrix_of(SCENE.mount.tool_from_tip_true)
    beyond_mm = STOP_MM - EXACT.bore_mm - EXACT.reach_mm
    return np.asarray((tip @ np.array([0.0, 0.0, beyond_mm, 1.0]))[:3])


def test_an_instrument_goes_as_deep_as_its_depth_stop(tmp_path: Path) -> None:
    assert tip_mm(a_world(), tmp_path) == pytest.approx(planned_mm(), abs=1e-9)


def test_an_instrument_is_off_the_axis_by_no_more_than_the_play_of_the_bore_allows(tmp_path: Path) -> None:
    guide = EXACT.model_copy(update={"play_mm": 0.1})
    beyond_mm = STOP_MM - guide.bore_mm
    most_mm = 0.05 * (1.0 + 2.0 * beyond_mm / guide.bore_mm)
    away = [float(np.linalg.norm(tip_mm(a_world(guide), tmp_path) - planned_mm()))]
    assert 0.0 < max(away) <= most_mm


@pytest.mark.parametrize(
    ("fault", "moved_mm"),
    [
        ("push guide 8 0 -4 N", (0.1, 0.0, -0.05)),  # over 80 N/mm
        ("wrong load 1 kg", (0.0, 0.0, -0.15)),
        ("depth stop off by 2 mm", (0.0, 0.0, -2.0)),
        ("wrong mandrel 5 mm", (0.0, 0.0, 0.0)),  # that is not the instrument
        ("bad seat 0.1 mm 0 deg", (0.0, 0.0, 0.1)),
    ],
)
def test_faults_move_the_tip_by_their_stated_amounts(
    tmp_path: Path, fault: str, moved_mm: tuple[float, float, float]
) -> None:
    world = a_world()
    world.set_fault_script(f"at 0 s: room {fault}")
    assert tip_mm(world, tmp_path) - planned_mm() == pytest.approx(moved_mm, abs=1e-9)


def test_each_mounting_seats_the_guide_a_little_differently(tmp_path: Path) -> None:
    seats_mm = []
    guide, other = SCENE.mount.tool_number_guide, SCENE.mount.tool_number_stereo
    for mounted in ([guide], [other, 0, other, guide], [guide, guide]):
        world = a_world(EXACT.model_copy(update={"seat_mm": 0.008}))
        for number in mounted:
            assert ControlledRoom(world, None).answer({"do": "mount", "number": number})["ok"]
        seats_mm.append(tip_mm(world, tmp_path) - planned_mm())
    first, same, again = seats_mm
    assert first == pytest.approx(same, abs=0.0)
    assert 0.0 < np.linalg.norm(again - first) < 0.1


@pytest.mark.parametrize("mistaken", [0, SCENE.mount.tool_number_stereo])
def test_staff_mount_the_wrong_tool_as_long_as_the_fault_lasts(mistaken: int) -> None:
    world, guide = a_world(), SCENE.mount.tool_number_guide
    room = ControlledRoom(world, None)
    world.set_fault_script(f"at 0 s: room wrong tool {mistaken}")
    assert room.answer({"do": "mount", "number": guide})["ok"]
    assert world.mounted_tool() == mistaken
    world.set_fault_script("")
    assert room.answer({"do": "mount", "number": guide})["ok"]
    assert world.mounted_tool() == guide


def test_a_wrong_tool_that_is_not_in_the_room_is_refused() -> None:
    with pytest.raises(BadFaultScript, match="expected tool 0, 1 or 2, got 7"):
        check_faults(parse_faults("at 0 s: room wrong tool 7"), SCENE)


def test_a_wrongly_set_depth_stop_reads_its_actual_value() -> None:
    world = a_world()
    world.set_fault_script("at 0 s: room depth stop off by -2 mm")
    assert Staff(world, None).work(DEPTH_STOP, "T1", (STOP_MM,)) == (STOP_MM - 2.0,)


def test_impossible_work_is_refused_with_a_reason(tmp_path: Path) -> None:
    room = ControlledRoom(a_world(), tmp_path)
    assert room.answer({"do": "work", "task": SKIN})["readings"] == []
    at_t1 = {"do": "work", "task": INSERT, "trajectory": "T1"}
    for request, reason in (
        (at_t1, "no depth stop was set"),
        ({"do": "work", "task": "tea"}, "unknown task 'tea'"),
        ({"do": "work"}, "bad request"),
        ({"do": "work", "task": DEPTH_STOP}, "depth_stop needs a length in mm; got no numbers"),
        ({"do": "work", "task": DEPTH_STOP, "numbers": [1, 2, 3]}, "a length in mm; got 1, 2, 3"),
        ({"do": "work", "task": DEPTH_STOP, "numbers": ["165"]}, "expected a number, got '165'"),
        ({"do": "work", "task": SKIN, "numbers": [float("nan")]}, "skin needs no numbers; got nan"),
        ({"do": "work", "task": GAUGE, "numbers": [1]}, "six joints in deg and the height"),
        ({"do": "mount", "number": 1.5}, "no tool 1.5"),
        ({"do": "mount", "number": True}, "expected a number, got True"),
    ):
        answer = room.answer(request)
        assert not answer["ok"]
        assert reason in answer["reason"]


def test_the_staff_know_every_task_word_and_no_other(tmp_path: Path) -> None:
    reason = ControlledRoom(a_world(), tmp_path).answer({"do": "work", "task": "tea"})["reason"]
    assert set(reason.partition("expected ")[2].split(", ")) == set(TASKS)


def test_an_instrument_is_not_inserted_without_the_name_of_a_trajectory(tmp_path: Path) -> None:
    room = ControlledRoom(a_world(), tmp_path)
    assert room.answer({"do": "work", "task": DEPTH_STOP, "trajectory": "T1", "numbers": [STOP_MM]})["ok"]
    answer = room.answer({"do": "work", "task": INSERT})
    assert not answer["ok"]
    assert answer["reason"] == "insert needs the name of a trajectory of the plan; got none"
    assert "--trajectory T1" in answer["advice"]
    assert read_samples(tmp_path) == []
    assert room.answer({"do": "work", "task": INSERT, "trajectory": "T1"})["ok"]
    assert [sample.target for sample in read_samples(tmp_path)] == ["T1"]


def test_an_instrument_is_inserted_only_where_the_depth_stop_was_set_for(tmp_path: Path) -> None:
    room = ControlledRoom(a_world(), tmp_path)
    assert room.answer({"do": "work", "task": DEPTH_STOP, "trajectory": "T1", "numbers": [STOP_MM]})["ok"]
    answer = room.answer({"do": "work", "task": INSERT, "trajectory": "T9"})
    assert answer["reason"] == "the depth stop was set for T1; got an order to insert at T9"
    assert read_samples(tmp_path) == []


@pytest.mark.parametrize("task", [SKIN, INSERT])
def test_nothing_is_done_through_a_stereo_head(tmp_path: Path, task: str) -> None:
    world = a_world()
    room = ControlledRoom(world, tmp_path)
    assert room.answer({"do": "work", "task": DEPTH_STOP, "trajectory": "T1", "numbers": [STOP_MM]})["ok"]
    world.mount_tool(SCENE.mount.tool_number_stereo)
    answer = room.answer({"do": "work", "task": task, "trajectory": "T1"})
    assert answer["reason"] == f"{task} is done through the guide, tool 2; mounted is the stereo head, tool 1"
    assert answer["advice"] == "Mount the guide first: ronna-sim mount 2."
    assert read_samples(tmp_path) == []


def shift_mm(world: World) -> tuple[float, float, float]:
    """Shift of the head relative to the robot."""
    return ShiftedRoom(world).now().head_mm


def test_a_locked_cart_does_not_move_when_pushed() -> None:
    world = a_world()
    Staff(world, None).work(CART_PUSH, "", ())
    assert shift_mm(world) == (0.0, 0.0, 0.0)


def test_an_unlocked_cart_rolls_and_stays_where_it_was_pushed() -> None:
    world = a_world()
    world.set_fault_script("at 0 s: room unlocked cart 6 0 -3 mm per min")
    world.clock.advance_cycle(30_000_000_000)
    assert shift_mm(world) == pytest.approx((-3.0, 0.0, 1.5))
    Staff(world, None).work(CART_PUSH, "", ())
    assert shift_mm(world) == pytest.approx((-9.0, 0.0, 4.5))


def test_a_since_fault_begins_with_its_step_and_outlasts_it() -> None:
    world = a_world()
    room = ControlledRoom(world, None)
    world.set_fault_script("since step == relocalization:T2: room shift cart 0 2 0 mm  # kicked")
    for step, moved_mm in (("relocalization:T1", 0.0), ("relocalization:T2", -2.0), ("retreat:T1", -2.0)):
        assert room.answer({"do": "step", "name": step})["ok"]
        assert shift_mm(world)[1] == moved_mm, step
    assert "since" not in world.fault_script()[1]


@pytest.mark.parametrize(
    ("fault", "task"),
    [("wrong tool 1", "no tool was mounted"), ("depth stop off by 4 mm", "no depth stop was set")],
)
@pytest.mark.parametrize(
    ("begins", "when"),
    [
        ("when step == positioning:T1", "while it lasted"),
        ("since step == positioning:T1", "after that"),
        ("now", "after that"),
    ],
)
def test_a_fault_that_came_after_its_last_task_is_named_with_its_step_and_the_reason(
    fault: str, task: str, begins: str, when: str
) -> None:
    world = a_world()
    room = ControlledRoom(world, None)
    if begins != "now":
        world.set_fault_script(f"{begins}: room {fault}")
    for request in (
        {"do": "step", "name": "tool_change"},
        {"do": "mount", "number": SCENE.mount.tool_number_guide},
        {"do": "work", "task": DEPTH_STOP, "trajectory": "T1", "numbers": [STOP_MM]},
    ):
        assert room.answer(request)["ok"]
    assert room.answer({"do": "missed_faults"})["missed"] == []  # its step may still come
    world.clock.advance_cycle(1_000_000_000)
    room.answer({"do": "step", "name": "positioning:T1"})
    if begins == "now":
        world.clock.advance_cycle(2_000_000_000)
        assert room.answer({"do": "fault", "line": f"now: room {fault}"})["ok"]
    world.clock.advance_cycle(3_000_000_000)
    room.answer({"do": "step", "name": "retreat:T1"})
    (missed,) = room.answer({"do": "missed_faults"})["missed"]
    assert missed == f"room {fault} had no effect: it began in positioning:T1, and {task} {when}"


def test_a_missed_fault_with_an_endless_number_is_cut_and_not_its_reason() -> None:
    world = a_world()
    room = ControlledRoom(world, None)
    world.set_fault_script(f"at 0 s: room depth stop off by {'9' * 3000} mm")
    (missed,) = room.answer({"do": "missed_faults"})["missed"]
    assert missed.endswith(
        "had no effect: it began before the first step, and no depth stop was set after that"
    )
    assert len(missed) < 300


def test_a_fault_that_acted_in_its_task_is_not_named_at_the_end() -> None:
    world = a_world()
    room = ControlledRoom(world, None)
    world.set_fault_script(
        "at 0 s: room wrong tool 1\nwhen step == at_target:T1: room depth stop off by 4 mm"
    )
    assert room.answer({"do": "mount", "number": SCENE.mount.tool_number_guide})["ok"]
    room.answer({"do": "step", "name": "at_target:T1"})
    assert room.answer({"do": "work", "task": DEPTH_STOP, "numbers": [STOP_MM]})["readings"] == [
        STOP_MM + 4.0
    ]
    room.answer({"do": "clear_faults", "line": "room wrong tool 1"})  # the other is in another line now
    assert room.answer({"do": "missed_faults"})["missed"] == []


def test_staff_touch_the_head_of_the_patient_on_the_given_side(tmp_path: Path) -> None:
    nose = Staff(a_world(), tmp_path).work(TOUCH, "", (0.0, -1.0, 0.0))
    head = SCENE.head
    place_ct = np.array(head.centre_ct_mm) - (0.0, head.semi_axes_mm[1], 0.0)
    assert nose == pytest.approx(head.robot_from_ct.transform(Frame.ROBOT, Frame.CT).apply(place_ct), abs=8.0)


def test_staff_measure_the_head_by_a_tape_less_well_than_they_touch_it(tmp_path: Path) -> None:
    staff, nose = Staff(a_world(), tmp_path), (0.0, -1.0, 0.0)
    readings = {task: [staff.work(task, "", nose) for _ in range(40)] for task in (TOUCH, MEASURE)}
    middles = {task: np.mean(each, axis=0) for task, each in readings.items()}
    spreads = {task: np.std(each, axis=0) for task, each in readings.items()}
    assert middles[MEASURE] == pytest.approx(middles[TOUCH], abs=8.0)
    assert (spreads[MEASURE] > 3.0 * spreads[TOUCH]).all()


def test_staff_touch_the_mark_of_a_trajectory_where_its_entry_is_on_the_patient(tmp_path: Path) -> None:
    staff, target = Staff(a_world(), tmp_path), SCENE.head.targets[0]
    place = SCENE.head.robot_from_ct.transform(Frame.ROBOT, Frame.CT).apply(target.entry_ct_mm)
    assert staff.work(SITE_MARK, target.identifier, ()) == pytest.approx(place, abs=8.0)
    with pytest.raises(TaskRefused, match="no site is marked for T9"):
        staff.work(SITE_MARK, "T9", ())


JOINTS = (0.0,) * 6


@pytest.fixture
def world() -> World:
    """A world with the tip of a tilted guide on the stand."""
    world = World.create(draw_scene("mini", seed=3), paced=False)
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
    scene = draw_scene("mini", seed=3)
    bent = scene.mount.guide.model_copy(update={"bent_mm": (1.0, 0.0, 0.0)})
    read = []
    for mount in (scene.mount, scene.mount.model_copy(update={"guide": bent})):
        world = World.create(scene.model_copy(update={"mount": mount}), paced=False)
        world.mount_tool(mount.tool_number_guide)
        world.put_on_stand(OnStand.DIVOT)
        flange = matrix_from(scene.stand.ball_mm, np.eye(3)) @ inverse(tip_at_calibration(world))
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
    with raises(STAND_NOT_READY, match="SIM-015"):
        read_dials(world)


def test_the_control_port_moves_the_stand_and_reads_it(world: World) -> None:
    room = ControlledRoom(world, None)
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
