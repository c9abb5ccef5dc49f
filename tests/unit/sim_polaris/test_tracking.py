"""Frames of the bench and of the theatre, as reported by the unit."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from polaris_bench import Bench, MakeBench

from sim.world.nominal_arm import description
from sim.world.options import Carrier
from sim.world.rigid import apply, inverse, matrix_of, quaternion_from_rotation
from sim.world.scene.model import Scene, TrackerTool
from sim.world.scene.named_scenes import (
    add_patient_frame,
    draw_scene,
    frame_on_clamp,
    frame_on_head,
    robot_frame,
)
from sim.world.true_arm import JointChain
from sim.world.truth import TrueGuide
from sim.world.world import ArmState


def frame_number(answer: str) -> int:
    return int(answer.split("\n")[0][-8:], 16)


def position(answer: str, tool: int = 0) -> np.ndarray:
    """Position of one tool in an answer to TX:0801 or TX:1801."""
    record = answer[2:].split("\n")[tool][2:]
    return np.array([float(record[24 + 7 * k : 31 + 7 * k]) / 100.0 for k in range(3)])


def strays(answer: str) -> np.ndarray:
    """Positions of the strays in an answer to TX:1801."""
    block = answer.rsplit("\n", 1)[1]
    count = int(block[:2], 16)
    digits = -(-count // 4)
    text = block[2 + digits : -4]
    return np.array([float(text[k : k + 7]) / 100.0 for k in range(0, len(text), 7)]).reshape(count, 3)


def put_arm(bench: Bench) -> np.ndarray:
    """Put an arm at home, which carries the reference frame M; return the true pose tracker <- M."""
    scene = bench.world.scene
    joints = tuple(np.radians(scene.arm.home_deg).tolist())
    flange = JointChain(description(scene.arm.variant)).flange(joints)
    bench.world.publish_arm(ArmState(joints, flange, 0, True))
    mount = scene.mount
    flange_from_marker = matrix_of(mount.flange_from_tool_true) @ matrix_of(mount.tool_from_marker_true)
    return inverse(matrix_of(scene.tracker.robot_from_tracker)) @ flange @ flange_from_marker


def with_arm(make_bench: MakeBench, scene: Scene, *tools: TrackerTool) -> Bench:
    """A unit that tracks tools in a room with an arm at home."""
    bench = make_bench(scene)
    put_arm(bench)
    return bench.ready().track(*tools)


def test_each_loaded_tool_of_the_bench_has_its_own_place(bench: Bench, pointer: TrackerTool) -> None:
    bench.track(pointer, robot_frame())
    answer = bench.send("TX 0801")
    places = bench.world.scene.tracker.places
    assert position(answer, 0) == pytest.approx(places[0].translation_mm, abs=1.0)
    assert position(answer, 1) == pytest.approx(places[1].translation_mm, abs=1.0)


def test_the_place_of_a_freed_tool_goes_to_the_next_tool(bench: Bench, pointer: TrackerTool) -> None:
    bench.enable(pointer)
    bench.enable(pointer)
    bench.send("PHF 01")
    bench.track(pointer)
    answer = bench.send("TX 0801")
    assert position(answer, 0) == pytest.approx((-150.0, -300.0, -1500.0), abs=1.0)
    assert position(answer, 1) == pytest.approx((-150.0, -100.0, -1500.0), abs=1.0)


def test_the_three_strays_of_the_bench_are_reported_in_any_order(bench: Bench, pointer: TrackerTool) -> None:
    bench.track(pointer)
    truth = np.array(bench.world.scene.tracker.strays_mm)
    orders = set()
    for _ in range(30):
        found = strays(bench.send("TX 1801"))
        nearest = [int(np.argmin(np.linalg.norm(truth - stray, axis=1))) for stray in found]
        assert np.abs(found - truth[nearest]).max() < 1.5
        orders.add(tuple(nearest))
    assert sorted(nearest) == [0, 1, 2]
    assert len(orders) == 6


def test_strays_are_not_seen_while_no_tool_makes_the_illuminators_fire(bench: Bench) -> None:
    bench.send("TSTART 80")
    assert bench.send("TX 1801") == "00" + "00" + "0000"


def test_each_request_gets_exactly_one_new_frame_on_an_unpaced_clock(
    bench: Bench, pointer: TrackerTool
) -> None:
    bench.track(pointer)
    began_ns = bench.world.clock.now_ns()
    numbers = [frame_number(bench.send("TX 0001")) for _ in range(60)]
    assert numbers == list(range(1, 61))
    assert bench.world.clock.now_ns() - began_ns == pytest.approx(1e9, abs=1)
    bench.world.clock.sleep(1.0)
    assert frame_number(bench.send("TX 0001")) == 121


def test_a_paced_clock_gives_sixty_frames_per_second_and_repeats_them(
    make_bench: MakeBench, pointer: TrackerTool, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = make_bench(paced=True)
    moments = [0.0]
    monkeypatch.setattr(bench.world.clock, "now_ns", lambda: round(moments[0] * 1e9))
    bench.send("INIT ")
    bench.track(pointer)
    answers = []
    for k in range(121):
        moments[0] = k / 120.0 + 1e-4
        answers.append(bench.raw("TX 0801"))
    assert answers[2] == answers[3]
    assert len(set(answers)) == 61
    assert frame_number(answers[120].decode()) == 60


@pytest.mark.parametrize(("rate", "step"), [("0", 3), ("1", 2), ("2", 1)])
def test_a_slower_illuminator_rate_skips_frame_numbers(
    bench: Bench, pointer: TrackerTool, rate: str, step: int
) -> None:
    bench.send(f"IRATE {rate}")
    bench.track(pointer)
    assert [frame_number(bench.send("TX 0001")) for _ in range(4)] == [step * k for k in range(1, 5)]


def test_option_80_and_a_reset_restart_the_frame_numbers_and_a_plain_start_does_not(
    bench: Bench, pointer: TrackerTool
) -> None:
    bench.track(pointer)
    for _ in range(10):
        bench.send("TX 0001")
    bench.send("TSTOP ")
    bench.send("TSTART ")
    assert frame_number(bench.send("TX 0001")) == 11
    bench.send("TSTOP ")
    bench.send("TSTART 80")
    assert frame_number(bench.send("TX 0001")) == 1
    bench.world.clock.sleep(1.0)
    bench.send("RESET 0")
    bench.send("INIT ")
    bench.enable(pointer)
    bench.send("TSTART ")
    assert frame_number(bench.send("TX 0001")) == 1  # a reset too begins anew


def test_noise_repeats_bit_for_bit_for_the_same_seed_and_frame(
    make_bench: MakeBench, pointer: TrackerTool
) -> None:
    def record(scene: Scene, skipped: int) -> list[bytes]:
        bench = make_bench(scene).ready().track(pointer)
        bench.world.clock.sleep((skipped + 0.5) / 60.0)
        return [bench.raw("BX 1803") for _ in range(20)]

    scene = draw_scene("bench")
    assert record(scene, 0) == record(scene, 0)
    # frames that nobody asked for change nothing in those that follow
    assert record(scene, 5) == record(scene, 0)[5:] + record(scene, 20)[:5]
    assert record(draw_scene("bench", seed=1), 0) != record(scene, 0)


def test_a_frame_lost_on_the_line_is_sent_again(make_bench: MakeBench, pointer: TrackerTool) -> None:
    def record(lost: int | None) -> list[bytes]:
        bench = make_bench().ready().track(pointer)
        heard = []
        for number in range(5):
            if number == lost:
                bench.raw("BX 1803")
                assert bench.send("ECHO INSTEP") == "INSTEP"
            heard.append(bench.raw("BX 1803"))
        return heard

    assert record(lost=0) == record(lost=3) == record(lost=None)


def test_a_lost_frame_is_not_sent_again_if_a_newer_one_is_due(bench: Bench, pointer: TrackerTool) -> None:
    bench.track(pointer)
    lost = frame_number(bench.send("TX 0001"))
    bench.world.clock.sleep(1.0)
    bench.send("ECHO INSTEP")
    assert frame_number(bench.send("TX 0001")) > lost + 59


def test_a_tool_is_fitted_to_its_noisy_markers(bench: Bench, pointer: TrackerTool) -> None:
    bench.track(pointer)
    errors = []
    for _ in range(300):
        raw = bench.raw("BX 0801")
        errors.append(struct.unpack_from("<f", raw, 6 + 1 + 2 + 28)[0])
    truth = bench.world.scene.tracker
    scale = (1500.0 / 1675.0) ** 2
    # 4 markers give 12 numbers, 6 of which the pose takes away: half of the variance is left
    left = scale * np.sqrt((2 * truth.noise_xy_mm**2 + truth.noise_z_mm**2) / 2)
    assert 0.5 * left < np.mean(errors) < 1.5 * left
    assert np.std(errors) > 0.1 * left


def test_the_reference_frame_is_tracked_on_the_arm(make_bench: MakeBench) -> None:
    scene = draw_scene("default")
    bench = make_bench(scene)
    truth = put_arm(bench)
    bench.send("INIT ")
    bench.track(robot_frame())
    answer = bench.send("TX 0001")
    assert position(answer) == pytest.approx(truth[:3, 3], abs=1.5)
    quaternion = [float(answer[k : k + 6]) / 1e4 for k in range(4, 28, 6)]
    assert quaternion == pytest.approx(quaternion_from_rotation(truth[:3, :3]), abs=0.01)


def test_fiducials_on_the_head_are_strays(make_bench: MakeBench) -> None:
    scene = draw_scene("mini", seed=4)
    bench = with_arm(make_bench, scene, robot_frame())
    answer = bench.send("TX 1801")
    assert "MISSING" not in answer
    tracker_from_ct = inverse(matrix_of(scene.tracker.robot_from_tracker)) @ matrix_of(
        scene.head.robot_from_ct
    )
    truth = apply(tracker_from_ct, [fiducial.centre_ct_mm for fiducial in scene.head.fiducials])
    found = strays(answer)
    assert len(found) == len(truth) == 3
    for centre in truth:
        assert np.linalg.norm(found - centre, axis=1).min() < 1.5


def test_the_frame_on_the_head_is_a_tool_when_loaded_and_strays_otherwise(make_bench: MakeBench) -> None:
    scene = draw_scene("mini", seed=3, fiducials=Carrier.XFRAME)
    here = inverse(matrix_of(scene.tracker.robot_from_tracker)) @ matrix_of(scene.head.robot_from_ct)
    spheres = apply(here, [one.centre_ct_mm for one in scene.head.fiducials])
    as_strays = with_arm(make_bench, scene, robot_frame())
    seen = strays(as_strays.send("TX 1801"))
    assert np.linalg.norm(seen[:, None] - spheres, axis=2).min(axis=0).max() < 1.5
    as_tool = with_arm(make_bench, scene, robot_frame(), frame_on_head())
    answer = as_tool.send("TX 1801")
    assert len(strays(answer)) == 0
    crossing = spheres[0] + 35.0 / 96.0 * (spheres[2] - spheres[0])
    assert position(answer, 1) == pytest.approx(crossing, abs=1.0)


def test_the_patients_frame_is_a_tool_when_loaded_and_strays_otherwise(make_bench: MakeBench) -> None:
    scene = add_patient_frame(draw_scene("mini", seed=3))
    on_clamp = scene.head.robot_from_patient_frame
    assert on_clamp is not None
    pose = inverse(matrix_of(scene.tracker.robot_from_tracker)) @ matrix_of(on_clamp)
    as_strays = strays(with_arm(make_bench, scene, robot_frame()).send("TX 1801"))
    markers = apply(pose, frame_on_clamp().markers_mm)
    assert np.linalg.norm(as_strays[:, None] - markers, axis=2).min(axis=0).max() < 1.5
    answer = with_arm(make_bench, scene, robot_frame(), frame_on_clamp()).send("TX 1801")
    assert position(answer, 1) == pytest.approx(pose[:3, 3], abs=1.0)
    assert np.linalg.norm(strays(answer)[:, None] - markers, axis=2).min() > 50.0


@pytest.mark.parametrize(("what", "moves"), [("head", 1.0), ("tracker", -1.0), ("cart", 0.0)])
def test_the_patients_frame_moves_with_the_head(make_bench: MakeBench, what: str, moves: float) -> None:
    scene = add_patient_frame(draw_scene("mini", seed=3))
    bench = with_arm(make_bench, scene, robot_frame(), frame_on_clamp())
    before = position(bench.send("TX 0801"), 1)
    bench.world.set_fault_script(f"now: room shift {what} 30 0 0 mm")
    way = position(bench.send("TX 0801"), 1) - before
    along = matrix_of(scene.tracker.robot_from_tracker)[0, :3]  # the robot's x in the tracker frame
    assert way == pytest.approx(moves * 30.0 * along, abs=1.0)


def test_the_frame_on_the_guide_is_tracked_only_while_the_guide_is_mounted(make_bench: MakeBench) -> None:
    scene = draw_scene("mini", seed=3)
    place = scene.mount.guide.tip_from_frame
    assert place is not None
    bench = with_arm(make_bench, scene, robot_frame(), scene.tracker.tools[-1])
    bench.world.mount_tool(scene.mount.tool_number_stereo)
    assert "MISSING" in bench.send("TX 0001").split("\n")[1]
    bench.world.mount_tool(scene.mount.tool_number_guide)
    tip = TrueGuide(bench.world).tip_frame()
    truth = inverse(matrix_of(scene.tracker.robot_from_tracker)) @ tip @ matrix_of(place)
    assert position(bench.send("TX 0001"), 1) == pytest.approx(truth[:3, 3], abs=1.5)


def test_a_wrong_definition_of_the_reference_frame_does_not_fit(make_bench: MakeBench) -> None:
    bench = make_bench(draw_scene("mini", seed=4))
    put_arm(bench)
    bench.send("INIT ")
    tool = robot_frame()
    bench.enable(tool.model_copy(update={"markers_mm": (*tool.markers_mm[:3], (-92.0, 30.0, 12.0))}))
    bench.send("TSTART 80")
    answer = bench.send("TX 1803")
    assert answer.startswith("0101MISSING00000031")
    assert answer.split("\n")[0][-22:-20] == "01"
    assert answer.split("\n")[0][-20:-16].count("2") >= 2
    assert len(strays(answer)) == 7


@pytest.mark.parametrize("line", ["tracker occlude tool robot_frame", "tracker occlude marker 2"])
def test_occlusion_faults_hide_the_named_tool_or_marker_for_their_duration(
    make_bench: MakeBench, line: str
) -> None:
    bench = make_bench(draw_scene("mini", seed=4))
    put_arm(bench)
    bench.send("INIT ")
    bench.enable(robot_frame())
    bench.world.set_fault_script(f"at 0.5 s: {line} for 0.5 s")
    bench.send("TSTART 80")
    seen = []
    for _ in range(90):
        answer = bench.send("TX 1801")
        seen.append(("MISSING" in answer, len(strays(answer))))
    usual, hidden = (False, 3), (True, 3) if "tool" in line else (False, 2)
    assert seen[:29] == [usual] * 29
    assert seen[30:59] == [hidden] * 29
    assert seen[60:] == [usual] * 30
