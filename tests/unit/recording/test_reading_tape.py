"""Device answers go onto the tape unchanged, and only those that a step of the procedure asked for."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recording_cell import HOME, RecordingArm, RecordingDevice

from ronna_hw.arm.clearance.sweep import ClosestPair
from ronna_hw.arm.errors import NotClear
from ronna_hw.arm.kinematics import SingularMeasure
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.path_preview import PathPreview
from ronna_hw.bounded_input import parse_json
from ronna_hw.devices import OpticalTracker, RobotArm
from ronna_hw.devices.axis_loads import AxisLoads
from ronna_hw.devices.lifecycle import Identity, Lifecycle
from ronna_hw.devices.readings import (
    AreaOfInterest,
    ArmReading,
    CameraImage,
    LinkStatistics,
    Stamp,
    StereoReading,
    StrayReading,
    ToolIdentity,
    ToolReading,
    TrackerFrame,
    Validity,
)
from ronna_hw.devices.robot import JointMove
from ronna_hw.recording.reading_coding import ANSWERS, as_plain, as_recorded
from ronna_hw.recording.reading_tape import READINGS_FILE, ReadingTape, tape_device

STAMP = Stamp(3, 17, 0.1 + 0.2, 0.3)
PIXELS = np.arange(12, dtype=np.uint16).reshape(3, 4)
IMAGE = CameraImage(STAMP, Validity.OK, "123", PIXELS, AreaOfInterest(0, 16, 4, 3))
TOOL = ToolReading("frame", Validity.OK, (1.0, 0.0, 0.0, 0.0), (1.0, 2.0, 1 / 3), 0.05)
GIVEN: dict[str, Any] = {
    "connect": Identity("NDI", "Spectra", "P1", "7", (("mode", "EXT"),)),
    "read_frame": TrackerFrame(
        STAMP, Validity.PARTIAL, (TOOL,), (StrayReading((1.0, 2.0, 3.0), Validity.OK),)
    ),
    "grab_pair": StereoReading(STAMP, Validity.MISSING, IMAGE, None),
    "read_state": ArmReading(STAMP, Validity.OK, HOME, None, moving=False),
    "read_tool_identity": ToolIdentity(STAMP, 2),
    "read_loads": AxisLoads(STAMP, Validity.OK, HOME, 100, current_percent=HOME),
    "limits": working_limits(kr6_r900("kr6_r900_sixx")),  # without a limit for bodies
    "link_statistics": LinkStatistics(9, 1, 2, 3, 4.5, 5.5, (0.0, 1.0), (7,)),
    "preview": PathPreview(
        1.0,
        ((0.0, 1.0),),
        ClosestPair("arm", "head", 3.0, 0.5),
        None,
        SingularMeasure(1.0, 2.0, 3.0),
        0.5,
        9.0,
        None,
    ),
}


@pytest.mark.parametrize("call", GIVEN)
def test_every_kind_of_answer_is_read_back_unchanged(call: str) -> None:
    kept: list[Any] = []

    def put(pixels: Any) -> dict[str, Any]:
        kept.append(pixels)
        return {"number": 0}

    plain = parse_json(json.dumps(as_plain(GIVEN[call], put)).encode())
    assert as_recorded(ANSWERS[call], plain, lambda where: kept[where["number"]]) == GIVEN[call]


@pytest.fixture
def tape(tmp_path: Path) -> Iterator[ReadingTape]:
    made = ReadingTape(tmp_path, lambda: 1.5, {"paced": True})
    yield made
    made.close()


def _lines(tape: ReadingTape, folder: Path) -> list[dict[str, Any]]:
    tape.close()
    return [json.loads(line) for line in (folder / READINGS_FILE).read_bytes().splitlines()][1:]


def test_only_answers_requested_by_the_step_itself_are_on_the_tape(tape: ReadingTape, tmp_path: Path) -> None:
    arm: Any = tape_device(RecordingArm("arm"), tape)
    arm.read_state()  # between two steps
    tape.begin(5)
    arm.read_tool_identity()
    with tape.beside():  # a guard
        arm.read_state()
    watch = threading.Thread(target=arm.read_state)
    watch.start()
    watch.join()
    tape.end()
    arm.read_state()
    (line,) = _lines(tape, tmp_path)
    assert (line["section"], line["device"], line["call"]) == (5, "arm", "read_tool_identity")
    assert line["theatre_time_s"] == 1.5


def test_an_error_is_raised_as_usual_and_recorded_with_the_resulting_state(
    tape: ReadingTape, tmp_path: Path
) -> None:
    arm: Any = tape_device(
        RecordingArm("arm", state=Lifecycle.FAULT, failing=NotClear("too near", got="2 mm")), tape
    )
    tape.begin(1)
    with pytest.raises(NotClear, match="too near"):
        arm.move(JointMove(HOME))
    (line,) = _lines(tape, tmp_path)
    assert (line["state"], line["error"]["code"], line["error"]["got"]) == ("fault", "ARM-007", "2 mm")


def test_a_device_on_tape_keeps_its_device_kinds(tape: ReadingTape) -> None:
    for device in (RecordingArm("arm"), RecordingDevice("tracker")):
        on_tape = tape_device(device, tape)  # type: ignore[arg-type]
        for kind in (RobotArm, OpticalTracker):
            assert isinstance(on_tape, kind) == isinstance(device, kind)


def test_settled_answers_are_on_disk(tape: ReadingTape, tmp_path: Path) -> None:
    arm: Any = tape_device(RecordingArm("arm"), tape)
    tape.begin(0)
    for _ in range(100):
        arm.read_state()
    tape.settle()
    assert (tmp_path / READINGS_FILE).read_bytes().count(b"read_state") == 100


def test_a_full_tape_ends_with_a_mark(tmp_path: Path) -> None:
    tape = ReadingTape(tmp_path, lambda: 0.0, {}, most_bytes=100)
    arm: Any = tape_device(RecordingArm("arm"), tape)
    tape.begin(0)
    arm.read_state()
    tape._write_waiting()
    arm.read_state()
    lines = _lines(tape, tmp_path)
    assert [line.get("call") for line in lines] == ["read_state", None]
    assert lines[-1] == {"full": True}


def test_an_answer_that_cannot_be_written_ends_the_tape_and_nothing_else(tmp_path: Path) -> None:
    tape = ReadingTape(tmp_path, lambda: 0.0, {})
    tape.begin(0)
    tape.keep("sensor", "read", Lifecycle.ACTIVE, object())
    tape.close()
    tape.keep("sensor", "read", Lifecycle.ACTIVE, None)
    assert not tape._queue
