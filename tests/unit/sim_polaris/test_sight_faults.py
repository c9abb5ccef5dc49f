"""Replies of the tracker while markers or light are disturbed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from polaris_bench import Bench, MakeBench

from ronna_hw.wire.polaris import MAXIMUM_STRAYS, PortStatus
from sim.polaris.measurement.optics import REFLECTION_PRESENCE
from sim.polaris.unit.model import PYRAMID
from sim.world.scene.model import Scene, TrackerTool
from sim.world.scene.named_scenes import draw_scene

POINTER_NUMBER = "8700340"
BENCH_STRAYS = 3


@dataclass(frozen=True)
class Told:
    """A reply to TX 1803 about one tool."""

    missing: bool
    position_mm: np.ndarray
    status: int
    information: int
    digits: str
    strays_mm: np.ndarray
    system_status: int


def tell(bench: Bench, options: str = "1803") -> Told:
    record, block = bench.send(f"TX {options}")[4:].split("\n")
    missing = record.startswith("MISSING")
    head = 7 if missing else 51
    position = [] if missing else [float(record[24 + 7 * k : 31 + 7 * k]) / 100.0 for k in range(3)]
    count = int(block[:2], 16)
    places = block[2 + -(-count // 4) : -4]
    return Told(
        missing,
        np.array(position),
        int(record[head : head + 8], 16),
        int(record[head + 16 : head + 18], 16),
        record[head + 18 : head + 22],
        np.array([float(places[k : k + 7]) / 100.0 for k in range(0, len(places), 7)]).reshape(-1, 3),
        int(block[-4:], 16),
    )


def test_an_undisturbed_tool_is_tracked(tracked: Bench) -> None:
    said = tell(tracked)
    assert not said.missing
    assert (said.status, said.information, said.digits) == (0x31, 0x10, "3333")
    assert len(said.strays_mm) == BENCH_STRAYS
    assert said.system_status == 0


def test_a_hidden_tool_is_reported_missing_for_too_few_markers(tracked: Bench) -> None:
    tracked.disturb(f"occlude tool {POINTER_NUMBER}")
    said = tell(tracked)
    assert said.missing
    assert (said.status, said.information, said.digits) == (0x31, 0x02, "0000")
    assert len(said.strays_mm) == BENCH_STRAYS


def test_a_tool_is_tracked_with_one_marker_hidden_but_not_with_two(tracked: Bench) -> None:
    tracked.disturb(f"occlude tool {POINTER_NUMBER} marker 2")
    one = tell(tracked)
    assert not one.missing
    assert one.digits == "3033"
    tracked.disturb(f"occlude tool {POINTER_NUMBER} marker 2", f"occlude tool {POINTER_NUMBER} marker 4")
    two = tell(tracked)
    assert two.missing
    assert (two.information, two.digits) == (0x02, "0000")
    assert len(two.strays_mm) == BENCH_STRAYS + 2  # its other markers are nobody's now


def test_a_bent_tool_does_not_fit_its_definition(tracked: Bench) -> None:
    tracked.disturb(f"bend tool {POINTER_NUMBER} 20 mm")
    said = tell(tracked)
    assert said.missing
    assert said.information == 0x01
    assert "2" in said.digits
    assert len(said.strays_mm) == BENCH_STRAYS + 4


def test_a_slightly_bent_tool_is_tracked_with_a_larger_error(tracked: Bench) -> None:
    straight = float(tracked.send("TX 0001")[49:55]) / 1e4
    tracked.disturb(f"bend tool {POINTER_NUMBER} 1.5 mm")
    bent = float(tracked.send("TX 0001")[49:55]) / 1e4
    assert bent > straight + 0.2


@pytest.mark.parametrize(("angle", "digits"), [("-60", "3333"), ("100", "1111"), ("-120", "1111")])
def test_a_tool_turned_beyond_its_angle_is_missing(tracked: Bench, angle: str, digits: str) -> None:
    tracked.disturb(f"turn tool {POINTER_NUMBER} {angle} deg")
    said = tell(tracked)
    assert said.missing is (digits == "1111")
    assert said.digits == digits
    assert said.information == (0x02 if said.missing else 0x10)


def test_a_tool_moved_out_of_the_volume_is_reported_only_on_request(tracked: Bench) -> None:
    tracked.disturb(f"move tool {POINTER_NUMBER} 0 0 -1000 mm")
    unasked = tell(tracked, "1003")
    assert unasked.missing
    assert unasked.status == 0x31 | PortStatus.OUT_OF_VOLUME
    assert (unasked.information, unasked.digits) == (0x02, "4444")
    asked = tell(tracked)
    assert asked.position_mm == pytest.approx((-150.0, -300.0, -2500.0), abs=2.5)
    assert asked.status == 0x31 | PortStatus.OUT_OF_VOLUME
    assert (asked.information, asked.digits) == (0x10, "5555")


def test_a_tool_partially_out_of_the_volume_is_flagged(tracked: Bench) -> None:
    _, half_y = PYRAMID.half_widths_mm(1500.0)
    tracked.disturb(f"move tool {POINTER_NUMBER} 0 {300.0 + half_y - 75.0:.1f} 0 mm")
    said = tell(tracked, "1003")
    assert said.status == 0x31 | PortStatus.PARTIALLY_OUT_OF_VOLUME
    assert not said.missing


def test_a_unit_may_hide_tools_that_are_partially_out(make_bench: MakeBench, pointer: TrackerTool) -> None:
    bench = make_bench(poses_partially_out=False).ready().track(pointer)
    _, half_y = PYRAMID.half_widths_mm(1500.0)
    bench.disturb(f"move tool {POINTER_NUMBER} 0 {300.0 + half_y - 75.0:.1f} 0 mm")
    assert tell(bench, "1003").missing
    assert not tell(bench, "1803").missing


def test_a_tool_behind_the_sensor_is_not_seen_at_all(tracked: Bench) -> None:
    tracked.disturb(f"move tool {POINTER_NUMBER} 0 0 3000 mm")
    said = tell(tracked)
    assert said.missing
    assert said.digits == "0000"


def test_additional_strays_stay_where_they_are(tracked: Bench) -> None:
    tracked.disturb("strays 5")
    first, second = tell(tracked).strays_mm, tell(tracked).strays_mm
    assert len(first) == len(second) == BENCH_STRAYS + 5
    for stray in first:
        assert np.linalg.norm(second - stray, axis=1).min() < 1.5


def test_no_more_strays_are_reported_than_the_unit_supports(tracked: Bench) -> None:
    tracked.disturb(f"strays {MAXIMUM_STRAYS}")
    assert len(tell(tracked).strays_mm) == MAXIMUM_STRAYS


def test_reflections_come_and_go(tracked: Bench) -> None:
    tracked.disturb("reflections 10")
    counts = [len(tell(tracked).strays_mm) - BENCH_STRAYS for _ in range(60)]
    assert len(set(counts)) > 2
    assert 0.5 * REFLECTION_PRESENCE < np.mean(counts) / 10 < 1.5 * REFLECTION_PRESENCE


def test_a_loose_stereo_match_reports_phantoms_on_the_epipolar_planes(tracked: Bench) -> None:
    tracked.disturb("phantoms 30 mm")
    said = tell(tracked)
    assert len(said.strays_mm) > BENCH_STRAYS
    truth = np.array(tracked.world.scene.tracker.strays_mm)
    ghosts = [stray for stray in said.strays_mm if np.linalg.norm(truth - stray, axis=1).min() > 5.0]
    # x / z is the epipolar plane: each phantom lies near that of a true marker
    tool = said.position_mm + np.array(
        [[0.0, 0.0, 0.0], [0.0, 50.0, 0.0], [25.0, 100.0, 0.0], [-25.0, 135.0, 0.0]]
    )
    slopes = np.array([x / z for x, _, z in (*truth, *tool)])
    assert ghosts
    for x, _, z in ghosts:
        assert np.abs(slopes - x / z).min() * abs(z) < 30.0


def test_sunlight_flags_too_much_infrared_for_system_and_tool_and_adds_strays(tracked: Bench) -> None:
    tracked.disturb("sunlight")
    seen = [tell(tracked) for _ in range(20)]
    assert all(said.system_status == 0x0002 for said in seen)
    assert all(said.status & PortStatus.IR_INTERFERENCE for said in seen)
    assert max(len(said.strays_mm) for said in seen) > BENCH_STRAYS


def test_interference_flags_the_tool_and_not_the_system(tracked: Bench) -> None:
    tracked.disturb(f"interference tool {POINTER_NUMBER}")
    said = tell(tracked)
    assert said.status == 0x31 | PortStatus.IR_INTERFERENCE
    assert said.information == 0x14
    assert said.system_status == 0


@pytest.mark.parametrize(
    "line",
    [f"move tool {POINTER_NUMBER} 0 0 -1000 mm", f"bend tool {POINTER_NUMBER} 20 mm", "strays 4", "sunlight"],
)
def test_a_fault_leaves_no_trace_after_it_ends(tracked: Bench, line: str) -> None:
    tracked.world.set_fault_script(f"at 0.5 s: tracker {line} for 0.5 s")
    seen = [tell(tracked) for _ in range(90)]
    for said in (*seen[:29], *seen[60:]):
        assert (said.status, said.digits, len(said.strays_mm), said.system_status) == (0x31, "3333", 3, 0)
    assert any(
        said.status != 0x31 or said.digits != "3333" or len(said.strays_mm) > 3 for said in seen[31:59]
    )


def test_the_same_faults_give_the_same_frames(make_bench: MakeBench, pointer: TrackerTool) -> None:
    def record() -> list[bytes]:
        bench = make_bench().ready().track(pointer)
        bench.disturb("sunlight", "strays 5", "phantoms 5 mm", f"bend tool {POINTER_NUMBER} 1 mm")
        return [bench.raw("BX 1803") for _ in range(20)]

    assert record() == record()


def phantom_scene() -> Scene:
    """The bench with two strays in one epipolar plane, and a unit that separates rays 0.5 mm apart."""
    scene = draw_scene("bench")
    pair = ((60.0, -80.0, -1600.0), (60.0, 40.0, -1600.0), (-90.0, 0.0, -1400.0))
    return scene.model_copy(
        update={"tracker": scene.tracker.model_copy(update={"strays_mm": pair, "line_separation_mm": 0.5})}
    )


def test_two_spheres_in_one_plane_with_both_sensors_make_two_phantoms(
    make_bench: MakeBench, pointer: TrackerTool
) -> None:
    bench = make_bench(phantom_scene()).ready().track(pointer)
    # two markers of the pointer lie in one plane with the sensors as well
    assert len(tell(bench).strays_mm) == 3 + 2 + 2
    bench.disturb(f"occlude tool {POINTER_NUMBER}")
    found = tell(bench).strays_mm
    assert len(found) == 3 + 2
    # similar triangles over the base of 500 mm: 1600 * 500 / (500 + 120) and / (500 - 120)
    assert found[:, 2].max() == pytest.approx(-1290.3, abs=2.5)
    assert found[:, 2].min() == pytest.approx(-2105.3, abs=2.5)


def test_out_of_volume_bits_mark_the_strays_outside(make_bench: MakeBench, pointer: TrackerTool) -> None:
    scene = draw_scene("bench")
    strays = ((0.0, 0.0, -1500.0), (0.0, 0.0, -2600.0), (0.0, 700.0, -1500.0))
    tracker = scene.tracker.model_copy(update={"strays_mm": strays})
    bench = make_bench(scene.model_copy(update={"tracker": tracker})).ready().track(pointer)
    for _ in range(10):
        block = bench.send("TX 1801").split("\n")[1]
        bits = int(block[2], 16)
        places = [[float(block[3 + 21 * k + 7 * j :][:7]) / 100.0 for j in range(3)] for k in range(3)]
        outside = [not PYRAMID.holds(*place) for place in places]
        assert outside == [bool(bits >> (2 - k) & 1) for k in range(3)]
        assert sum(outside) == 2
