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
from ronna_hw.recording.reading_coding import ANSWERS, as_plain, as_recorded, pack_pixels, unpack_pixels
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


@pytest.mark.parametrize(("kind", "largest"), [(np.uint8, 255), (np.uint16, 4095), (np.uint16, 65535)])
@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (64, 48)])
def test_any_picture_comes_back_bit_for_bit(kind: type, largest: int, shape: tuple[int, int]) -> None:
    pixels = np.random.default_rng(7).integers(0, largest, shape, endpoint=True).astype(kind)
    pixels.flags.writeable = False
    again = unpack_pixels(pack_pixels(pixels), shape, str(pixels.dtype))
    assert again.dtype == pixels.dtype
    assert not again.flags.writeable
    np.testing.assert_array_equal(again, pixels)


def test_a_slice_of_a_larger_picture_comes_back_unchanged() -> None:
    part = np.arange(400, dtype=np.uint16).reshape(20, 20)[2:8, 3:9]
    np.testing.assert_array_equal(unpack_pixels(pack_pixels(part), part.shape, "uint16"), part)


def test_noise_of_four_grey_values_packs_to_less_than_half_its_size() -> None:
    noise = (100 + np.random.default_rng(1).normal(0, 1.2, (200, 200))).astype(np.uint8)
    assert len(pack_pixels(noise)) < 0.5 * noise.nbytes


@pytest.mark.parametrize("damaged", [b"", b"no zlib at all", pack_pixels(np.zeros((2, 2), np.uint8))])
def test_damaged_bytes_are_refused(damaged: bytes) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        unpack_pixels(damaged, (3, 3), "uint8")
