"""Hazards 3, 17, 25, 26, 37: a wrong tool or camera, an old calibration, and packets that cameras lose."""

from __future__ import annotations

import json
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from arm_looks import ENDPOINTS
from coded_errors import raises
from recording_cell import GUIDE, STEREO_HEAD, RecordingCell
from run_folders import records_of
from user_commands import Commands

from drivers.ndi_polaris import PolarisTracker
from drivers.ndi_polaris.errors import FOREIGN_TOOL
from drivers.ndi_polaris.shipped_tools import FOLDER as SHIPPED_DEFINITIONS
from procedures.engine.order import order_of
from procedures.journal.errors import StepRefused
from procedures.relocalization.errors import WRONG_CAMERA
from procedures.steps.clinical import set_up
from procedures.workcell.errors import WrongTool
from ronna_hw.calibration import CalibrationExpired
from ronna_hw.clock import open_clock
from ronna_hw.config import parse_theatre
from ronna_hw.errors import EXIT_REFUSED
from ronna_hw.roles import MASTER
from sim.theatre.theatre_file import theatre_content
from sim.world.process import load_scene

SET_UP = order_of([set_up.STEP], ())


@pytest.fixture
def cell(tmp_path: Path) -> RecordingCell:
    return RecordingCell(tmp_path)


def run_set_up(cell: RecordingCell, **changed: Any) -> None:
    cell.workcell = cell.make_workcell(cell.calibrations.model_copy(update=changed))
    cell.engine(SET_UP).run_to()


@pytest.mark.hazard(37)
@pytest.mark.parametrize("mounted", [0, GUIDE])
def test_the_case_does_not_start_without_the_stereo_head_mounted(cell: RecordingCell, mounted: int) -> None:
    cell.arm.mounted = mounted
    with pytest.raises(WrongTool, match=f"number {STEREO_HEAD}, got number {mounted}"):
        run_set_up(cell)
    assert cell.arm.motions == []


@pytest.mark.hazard(25)
def test_set_up_refuses_swapped_cameras(cell: RecordingCell) -> None:
    left, right = cell.stereo.serials
    cell.stereo.serials = (right, left)
    with raises(WRONG_CAMERA) as refused:
        run_set_up(cell)
    assert refused.value.exit_code == EXIT_REFUSED


@pytest.mark.hazard(26)
@pytest.mark.parametrize("record", ["stereo_head", "tool_tip", "tracker_frame"])
def test_set_up_refuses_an_expired_calibration(cell: RecordingCell, record: str) -> None:
    calibration = getattr(cell.calibrations, record)
    expired = calibration.model_copy(update={"expires": datetime.now(UTC) - timedelta(seconds=1)})
    with pytest.raises(CalibrationExpired) as refused:
        run_set_up(cell, **{record: expired})
    assert refused.value.exit_code == EXIT_REFUSED
    assert ("ronna-tool renew" in refused.value.advice) is (record == "tool_tip")


@pytest.mark.hazard(26)
def test_set_up_refuses_an_expired_arm_calibration(cell: RecordingCell) -> None:
    content = theatre_content(load_scene("mini", seed=3, calibrated=True), ENDPOINTS, "host:", {}, 1.0)
    calibrations = parse_theatre(content).calibration
    assert calibrations is not None
    assert calibrations.arm is not None
    ended = datetime.now(UTC) - timedelta(seconds=1)
    with pytest.raises(CalibrationExpired, match="ronna-arm calibrate"):
        run_set_up(cell, arm=calibrations.arm.model_copy(update={"expires": ended}))


@pytest.mark.hazard(29)
def test_a_calibration_dated_in_the_future_is_refused_because_the_clock_may_have_been_set_back(
    cell: RecordingCell,
) -> None:
    to_come = cell.calibrations.tool_tip.model_copy(update={"created": datetime.now(UTC) + timedelta(days=2)})
    with pytest.raises(CalibrationExpired, match="in the future"):
        run_set_up(cell, tool_tip=to_come)


def test_the_result_of_set_up_contains_the_notices_of_the_drivers(cell: RecordingCell) -> None:
    notice = "left: the camera sends no test packets; packets of 1500 bytes"
    cell.stereo.notices = (notice,)
    run_set_up(cell)
    done = cell.case.get(set_up.CheckedSetUp).result
    assert done.notices == (f"stereo: {notice}",)
    assert done.homes_rad == {MASTER: cell.arm.joints_rad}


def test_connected_devices_are_not_connected_again(cell: RecordingCell) -> None:
    engine = cell.engine(SET_UP)
    engine.run_to()
    engine.machine = type(engine.machine)(SET_UP)  # as if the case went on
    with pytest.raises(StepRefused, match="already connected: tracker, arm, stereo"):
        engine.run_step(engine.order.find("set_up"))


TOOL = "robot_frame"


@pytest.mark.hazard(17)
def test_a_definition_replaced_after_the_theatre_was_set_up_is_refused(tmp_path: Path) -> None:
    rom = tmp_path / "robot_frame.rom"
    shutil.copy(SHIPPED_DEFINITIONS / "robot_frame.rom", rom)
    endpoints = {
        "polaris": "tcp://127.0.0.1:8765",
        "kuka": {"rsi": "udp://127.0.0.1:1", "eki_project": "tcp://127.0.0.1:2"},
        "basler": {"left": "gev://127.0.0.2", "right": "gev://127.0.0.3"},
    }
    theatre = parse_theatre(theatre_content(load_scene("mini"), endpoints, "host:", {TOOL: str(rom)}, 1.0))
    assert theatre.tracker is not None
    PolarisTracker("tracker", theatre.tracker, open_clock("host:"))
    shutil.copy(SHIPPED_DEFINITIONS / "x_frame.rom", rom)
    with raises(FOREIGN_TOOL, match=r"NDI-013.*robot_frame"):
        PolarisTracker("tracker", theatre.tracker, open_clock("host:"))


LARGEST_ERROR_MM = 1.5


@pytest.mark.hazard(25)
@pytest.mark.slow
@pytest.mark.timeout(180)
@pytest.mark.parametrize(
    "faults",
    [
        "when step == relocalization: camera drop 3 %\n",
        "when step == relocalization: camera lose left 1 % for 4 s\n"
        "when step == relocalization: camera forget left for 4 s\n",
    ],
    ids=["packets are sent again", "the left camera has forgotten them"],
)
def test_a_case_whose_cameras_lose_packets_reaches_its_target(
    commands: Commands, tmp_path: Path, faults: str
) -> None:
    script = tmp_path / "faults.txt"
    script.write_text(faults)
    options = ("--scene", "mini", "--seed", "3", "--faults", str(script), "--out", str(tmp_path / "runs"))
    done = commands.run("ronna-procedure", "run", "--sim", "--json", *options, timeout_s=150)
    assert done.returncode == 0, done.stderr
    outcome = json.loads(done.stdout)
    assert outcome["max_application_error_mm"] <= LARGEST_ERROR_MM
    folder = tmp_path / "runs" / outcome["run"]
    (fine,) = [record for record in records_of(folder) if record.kind == "relocalization"]
    assert len(fine.payload["fiducials"]) == outcome["markers"]
    lines = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    (streams,) = [line["streams"] for line in lines if line.get("device") == "stereo" and "streams" in line]
    assert sum(stream["resend_requests"] + stream["incomplete_frames"] for stream in streams) > 0
