"""Diagnostic mode: single markers, illuminator firing, ambient infrared."""

from __future__ import annotations

import numpy as np
import pytest
from polaris_bench import Bench, MakeBench

from sim.world.scene.model import TrackerTool
from sim.world.scene.named_scenes import robot_frame


@pytest.fixture
def diagnostic(bench: Bench, pointer: TrackerTool) -> Bench:
    """The bench in diagnostic mode with one initialised tool."""
    bench.enable(pointer)
    assert bench.send("DSTART ") == "OKAY"
    return bench


@pytest.mark.parametrize("line", ["DSTOP ", "IRED 0100000001", "3D 015", "IRINIT ", "IRCHK 0001"])
def test_diagnostic_commands_are_refused_outside_diagnostic_mode(
    make_bench: MakeBench, bench: Bench, line: str
) -> None:
    assert make_bench().send(line) == "ERROR10"
    assert bench.send(line) == "ERROR0C"
    bench.send("TSTART ")
    assert bench.send(line) == "ERROR0C"


def test_3d_reports_every_marker_with_its_line_separation(diagnostic: Bench, pointer: TrackerTool) -> None:
    count, *records = diagnostic.send("3D 015").split("\n")
    assert count == "007"  # four of the tool, three strays
    assert {len(record) for record in records} == {3 * 9 + 4 + 1}
    places = np.array([[float(record[9 * k : 9 * k + 9]) / 1e4 for k in range(3)] for record in records])
    tracker = diagnostic.world.scene.tracker
    tool = np.array(pointer.markers_mm) + tracker.places[0].translation_mm
    for truth in (*tool, *tracker.strays_mm):
        assert np.linalg.norm(places - truth, axis=1).min() < 2.0
    assert {record[27:31] for record in records} == {"0005"}
    assert {record[31] for record in records} == {"0"}


def test_3d_measures_one_tool_after_the_other(bench: Bench, pointer: TrackerTool) -> None:
    bench.enable(pointer)
    bench.enable(robot_frame())
    bench.send("DSTART ")
    assert [bench.send(f"3D {handle:02}5")[:3] for handle in (1, 2, 1)] == ["007"] * 3


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("3D 011", "ERROR23"),
        ("3D 01", "ERROR07"),
        ("3D 025", "ERROR2B"),
        ("IRED 0100000001", "ERROR32"),  # a passive tool does not fire
        ("IRED 01", "ERROR07"),
        ("IRCHK 0001", "ERROR1B"),
        ("IRCHK 0004", "ERROR23"),
    ],
)
def test_arguments_are_checked(diagnostic: Bench, line: str, answer: str) -> None:
    assert diagnostic.send(line) == answer


def test_irchk_reports_no_ambient_infrared(diagnostic: Bench) -> None:
    assert diagnostic.send("IRINIT ") == "OKAY"
    assert diagnostic.send("IRCHK 0001") == "0"
    assert diagnostic.send("IRCHK ") == "0"
    assert diagnostic.send("IRCHK 0003") == "0" + "000" + "000"


def test_irchk_reports_an_error_in_sunlight(diagnostic: Bench) -> None:
    diagnostic.send("IRINIT ")
    diagnostic.world.set_fault_script("now: tracker sunlight")
    assert diagnostic.send("IRCHK 0001") == "ERRORF1"


def test_a_unit_with_a_hardware_fault_does_not_enter_diagnostic_mode(bench: Bench) -> None:
    bench.send("SET Param.Simulated Alerts=1")
    assert bench.send("DSTART ") == "ERROR16"
