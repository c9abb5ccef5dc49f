"""Log of a run: read by others, small, whole after a kill, and nobody's business when its disk is full."""

from __future__ import annotations

import errno
import io
import os
import subprocess
import sys
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coded_errors import raises
from mcap.reader import make_reader
from plain_steps import plain_order

from procedures.live import log_reading
from procedures.live.errors import EMPTY_LOG, FOREIGN_LOG, NO_LOG
from procedures.live.feed import LOCK_STEP_PERIOD_S, PACED_PERIOD_S
from procedures.live.flight_log import FLUSH_PERIOD_S, FlightLog, next_log_file
from procedures.live.log_entries import ArmDrawing, JointCycles, JournalEntry, Level, LogEntry, SaidLine
from procedures.live.log_reading import recover_log
from procedures.live.log_tables import read_topic
from procedures.live.log_topics import LogMessages
from procedures.live.log_writer import LogWriter
from procedures.live.records import (
    Began,
    CameraPicture,
    DeviceStatus,
    Fiducial,
    Fiducials,
    FramePose,
    PlannedLine,
    PlannedLines,
    RunState,
)
from ronna_hw.arguments import WrongArgument
from ronna_hw.devices.readings import Validity
from ronna_hw.errors import DataError

EPOCH_NS = 1_700_000_000_123_456_789
BEGAN = Began(theatre_time_s=0.0, run="R1", epoch_ns=EPOCH_NS)
AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
CYCLES_PER_S, POSES_PER_S = 250, 60
LARGEST_MB_OF_TEN_MINUTES = 60.0
TURN = (0.5, 0.5, -0.5, 0.5)


def _as_named(text: str) -> str:
    return text


def _cycles(second: int) -> JointCycles:
    """One second of an arm on its way, with the noise of its encoders."""
    times_s = second + np.arange(CYCLES_PER_S) / CYCLES_PER_S
    commanded = np.sin(times_s[:, None] / 5.0 + np.arange(6))
    noise = np.random.default_rng(second).normal(0.0, 2e-5, commanded.shape)
    return JointCycles("master", AXES, times_s, commanded + noise, commanded)


def _pose(at_s: float, parent: str = "robot", child: str = "flange", **more: Any) -> FramePose:
    place_mm = (400.0 + 50.0 * np.sin(at_s), 100.0 * np.cos(at_s), 700.0)
    return FramePose(
        theatre_time_s=at_s, parent=parent, child=child, rotation=TURN, translation_mm=place_mm, **more
    )


ENTRIES: list[LogEntry] = [
    _cycles(0),
    _pose(1.0),
    _pose(1.5, "ct", "robot", is_fixed=True),
    FramePose(
        theatre_time_s=1.6,
        parent="tracker",
        child="patient",
        rotation=None,
        translation_mm=None,
        validity=Validity.MISSING,
    ),
    _pose(1.7, "tracker", "patient", validity=Validity.OUT_OF_VOLUME),
    CameraPicture(theatre_time_s=2.0, side="left", width=2, height=2, jpeg="/9j/2Q=="),
    Fiducials(
        theatre_time_s=2.5,
        spheres=(
            Fiducial(name="M1", position_mm=(1.0, 2.0, 3.0), diameter_mm=5.0, residual_mm=0.1, is_used=True),
        ),
    ),
    PlannedLines(
        theatre_time_s=2.6,
        lines=(PlannedLine(name="T1", entry_mm=(0.0, 0.0, 90.0), target_mm=(1000.0, 0.0, 0.0)),),
    ),
    RunState(theatre_time_s=3.0, run="R1", state="operation.registration", step="registration:T1"),
    DeviceStatus(theatre_time_s=3.1, device="tracker", state="fault", code="NDI-004", text="no reply"),
    SaidLine(3.5, Level.WARNING, "the head has moved"),
    ArmDrawing(3.6, "<robot/>"),
    JournalEntry(4.0, {"entry": "result", "step": "registration:T1"}),
]
TOPICS = {
    "/measured_js": 250, "/setpoint_js": 250, "/measured_cp": 1, "/tf": 1, "/tf_static": 2, "/spheres": 1,
    "/plan": 1, "/camera_left/image/compressed": 1, "/operating_state": 2, "/rosout": 1,
    "/robot_description": 1, "/journal": 1,
}  # fmt: skip


@pytest.fixture
def sealed(tmp_path: Path) -> Path:
    path = next_log_file(tmp_path)
    log = FlightLog(path, BEGAN, _as_named)
    log.take(ENTRIES)
    log.close()
    return path


def test_a_sealed_log_has_index_statistics_and_sums_and_only_usable_poses(sealed: Path) -> None:
    with sealed.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        counts = summary.statistics.channel_message_counts
        assert {channel.topic: counts[number] for number, channel in summary.channels.items()} == TOPICS
        assert reader.get_header().profile == "ros2"
        stamps = {m.log_time for _, _, m in reader.iter_messages(topics=["/journal"])}
    assert stamps == {EPOCH_NS + 4 * 10**9}


def test_rosbags_reads_every_message_by_its_own_definitions(sealed: Path) -> None:
    rosbags = pytest.importorskip("rosbags.highlevel", reason="proof not made: install the extra `strangers`")
    types = pytest.importorskip("rosbags.typesys")
    store = types.get_typestore(types.Stores.ROS2_JAZZY)
    found: dict[str, list[Any]] = {}
    with rosbags.AnyReader([sealed], default_typestore=store) as reader:
        for connection, stamp_ns, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            assert reader.deserialize(data, connection.msgtype) is not None
            found.setdefault(connection.topic, []).append((stamp_ns, message))
    assert {topic: len(messages) for topic, messages in found.items()} == TOPICS
    cycles = _cycles(0)
    for row, (stamp_ns, joints) in enumerate(found["/measured_js"]):
        assert joints.name == list(AXES)
        assert joints.position.tolist() == cycles.measured_rad[row].tolist()
        assert joints.header.stamp.sec * 10**9 + joints.header.stamp.nanosec == stamp_ns
        assert len(joints.velocity) == len(joints.effort) == 0
    ((_, placed),) = found["/tf"]
    (transform,) = placed.transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("robot", "flange")
    assert transform.transform.translation.z == pytest.approx(0.7)  # metres
    turn = transform.transform.rotation
    assert (turn.w, turn.x, turn.y, turn.z) == TURN
    ((_, plan),) = found["/plan"]
    assert [(p.x, p.y, p.z) for p in plan.markers[0].points] == [(0.0, 0.0, 0.09), (1.0, 0.0, 0.0)]
    ((_, picture),) = found["/camera_left/image/compressed"]
    assert (picture.format, picture.data.tobytes()) == ("jpeg", b"\xff\xd8\xff\xd9")
    assert found["/rosout"][0][1].msg == "the head has moved"


def test_ten_minutes_of_joints_and_poses_fit_into_sixty_megabytes() -> None:
    file, seconds = io.BytesIO(), 20
    writer = LogWriter(file, BEGAN, _as_named)
    frames = (("robot", "flange"), ("tracker", "robot_frame"), ("tracker", "patient"))
    for second in range(seconds):
        writer.write(_cycles(second), EPOCH_NS)
        for tick in range(POSES_PER_S):
            for parent, child in frames:
                writer.write(_pose(second + tick / POSES_PER_S, parent, child), EPOCH_NS)
        writer.flush()
    writer.finish()
    assert len(file.getvalue()) / 1e6 * 600 / seconds <= LARGEST_MB_OF_TEN_MINUTES


WRITE_UNTIL_KILLED = """
import sys
from pathlib import Path

from procedures.live.flight_log import FlightLog
from procedures.live.log_entries import Level, SaidLine
from procedures.live.records import Began

log = FlightLog(Path(sys.argv[1]), Began(theatre_time_s=0.0, run="R1", epoch_ns=0), str, flush_period_s=0.05)
taken = said = 0
while True:
    if taken < log.flushed + 1000:
        log.take([SaidLine(taken * 1e-3, Level.INFO, f"line {taken}")])
        taken += 1
    if log.flushed > said:
        said = log.flushed
        print(said, flush=True)
"""


def test_a_killed_program_leaves_all_that_it_had_flushed_which_is_all_but_the_last_second(
    tmp_path: Path,
) -> None:
    assert FLUSH_PERIOD_S + max(PACED_PERIOD_S, LOCK_STEP_PERIOD_S) <= 1.0
    path, environment = tmp_path / "flight.mcap", {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        [sys.executable, "-P", "-c", WRITE_UNTIL_KILLED, str(path)],
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    ) as child:
        assert child.stdout is not None
        flushed = [int(child.stdout.readline()) for _ in range(3)]
        child.kill()
        flushed += [int(line) for line in child.stdout if line.endswith("\n")]
    recovered = recover_log(path, tmp_path / "recovered.mcap")
    assert not recovered.was_whole
    assert recovered.messages >= flushed[-1]
    with recovered.path.open("rb") as file:
        texts = [m.data for _, _, m in make_reader(file).iter_messages()]
    assert all(f"line {number}\0".encode() in text for number, text in enumerate(texts))


def test_a_log_cut_anywhere_is_recovered_up_to_the_cut_or_refused(sealed: Path, tmp_path: Path) -> None:
    content = sealed.read_bytes()
    cut, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    recovered = []
    for size in np.linspace(0, len(content), 40).astype(int).tolist():
        cut.write_bytes(content[:size])
        recovered.append(_recover_or_refuse(cut, out))
        assert not list(tmp_path.glob(".*"))  # nothing half written is left
    assert (recovered[0], recovered[-1]) == (0, sum(TOPICS.values()))


def _recover_or_refuse(log: Path, out: Path) -> int:
    """Number of messages recovered; none where it was refused with a code."""
    try:
        return recover_log(log, out).messages
    except DataError as error:
        if error.code not in (FOREIGN_LOG.code, EMPTY_LOG.code):
            raise
        return 0


def test_damaged_bytes_of_a_log_never_raise_more_than_a_coded_error(sealed: Path, tmp_path: Path) -> None:
    content, random = sealed.read_bytes(), np.random.default_rng(1)
    damaged = tmp_path / "damaged.mcap"
    for _ in range(200):
        changed = bytearray(content)
        for place in random.integers(8, len(content), 3):
            changed[place] ^= int(random.integers(1, 256))
        damaged.write_bytes(changed)
        assert _recover_or_refuse(damaged, tmp_path / "out.mcap") <= sum(TOPICS.values())


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    foreign = tmp_path / "flight.mcap"
    foreign.write_bytes(b"#ROSBAG V2.0\n")
    with raises(FOREIGN_LOG):
        list(log_reading.read_log(foreign))


class _FullDisk(io.BytesIO):
    """File that takes so many writes."""

    def __init__(self, writes: int) -> None:
        super().__init__()
        self._writes = writes

    def write(self, _data: Any) -> int:
        self._writes -= 1
        if self._writes < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().write(_data)


@pytest.mark.parametrize("writes", [0, 3, 40])
def test_a_full_disk_ends_the_log_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writes: int
) -> None:
    monkeypatch.setattr(Path, "open", lambda *_: _FullDisk(writes))
    log = FlightLog(tmp_path / "flight.mcap", BEGAN, _as_named, flush_period_s=0.01)
    for second in count():
        log.take([_cycles(second)])
        if not log.is_open:
            break
    log.take(ENTRIES)
    log.close()


def test_a_log_whose_disk_does_not_keep_up_ends_instead_of_growing(tmp_path: Path) -> None:
    log = FlightLog(
        tmp_path / "flight.mcap", BEGAN, _as_named, flush_period_s=1e6, most_waiting_bytes=100_000
    )
    for second in range(100):
        log.take([_cycles(second)])
    assert not log.is_open
    log.close()


def test_a_later_program_of_the_run_writes_a_file_of_its_own(sealed: Path) -> None:
    assert next_log_file(sealed.parent).name == "flight-2.mcap"


def test_a_topic_of_the_log_is_an_array_in_millimetres_with_its_nearest_name_suggested(sealed: Path) -> None:
    joints, poses = read_topic(sealed.parent, "/measured_js"), read_topic(sealed.parent, "/measured_cp")
    assert joints.joints_rad.tolist() == _cycles(0).measured_rad.tolist()
    assert joints.time_s == pytest.approx(_cycles(0).times_s, abs=1e-9)
    assert joints.utc_ns[0] == EPOCH_NS
    assert (poses.parent[0], poses.position_mm[0].tolist()) == ("robot", [*_pose(1.0).translation_mm])
    assert poses.rotation_wxyz[0].tolist() == list(TURN)
    with raises(WrongArgument, match=r"no topic /mesured_js.*Did you mean /measured_js"):
        read_topic(sealed.parent, "/mesured_js")


def test_a_run_of_an_earlier_version_has_no_log(tmp_path: Path) -> None:
    with raises(NO_LOG):
        read_topic(tmp_path, "/measured_js")


@pytest.mark.hazard(35)
def test_names_of_trajectories_are_in_no_message(sealed: Path) -> None:
    named: list[LogEntry] = [
        RunState(
            theatre_time_s=0.0, run="R1", state="held", step="registration:Seeded", reason="Seeded moved"
        ),
        DeviceStatus(theatre_time_s=0.0, device="arm", state="fault", text="on the way to Seeded"),
        SaidLine(0.0, Level.INFO, "at Seeded"),
        JournalEntry(0.0, {"sequence": 2, "step": "registration:Seeded"}),
        PlannedLines(
            theatre_time_s=0.0,
            lines=(PlannedLine(name="Seeded", entry_mm=(0.0, 0.0, 0.0), target_mm=(0.0, 0.0, 9.0)),),
        ),
    ]
    order = plain_order("2", "Seeded")
    messages = LogMessages(BEGAN, order.without_names)
    encoded = [message.data for entry in named for message in messages.of(entry)]
    assert len(encoded) == len(named)
    assert not any(b"Seeded" in data for data in encoded)
    assert any(b'{"sequence": 2, "step": "registration:2"}' in data for data in encoded)


def test_an_entry_that_has_no_form_as_a_message_is_skipped_and_the_log_goes_on(tmp_path: Path) -> None:
    log = FlightLog(tmp_path / "flight.mcap", BEGAN, _as_named)
    log.take([SaidLine(0.0, Level.INFO, "of \udcff"), SaidLine(1e300, Level.INFO, "never")])
    log.take([SaidLine(1.0, Level.ERROR, "the fault that matters")])
    log.close()
    assert log.is_open
    with (tmp_path / "flight.mcap").open("rb") as file:
        (said,) = (content.data for _, _, content in make_reader(file).iter_messages("/rosout"))
    assert b"the fault that matters" in said
