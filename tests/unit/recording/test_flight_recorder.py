"""The flight recorder: traffic is kept within bounds, and its producers never wait or fail."""

from __future__ import annotations

import gzip
import os
import shutil
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from user_commands import in_this_process
from waiting import eventually

from procedures.cli.procedure import app as ronna_procedure
from ronna_hw.devices.capabilities import Direction, PassedBytes
from ronna_hw.recording import flight_recorder
from ronna_hw.recording.flight_recorder import BYTES_FOLDER, FlightRecorder, LinkLine, list_links, read_link

SENT, RECEIVED = Direction.SENT, Direction.RECEIVED
PCAP_HEAD, PACKET_HEAD = 24, struct.Struct("<IIII")

Make = Callable[..., FlightRecorder]


class Theatre:
    """Its time, by hand."""

    def __init__(self) -> None:
        self.moment_s = 0.0

    def now_s(self) -> float:
        if self.moment_s < 0.0:
            raise ValueError("the clock has ended")
        return self.moment_s


@pytest.fixture
def theatre() -> Theatre:
    return Theatre()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / BYTES_FOLDER


@pytest.fixture
def make(folder: Path, theatre: Theatre) -> Iterator[Make]:
    made: list[FlightRecorder] = []

    def recorder(**limits: int) -> FlightRecorder:
        made.append(FlightRecorder(folder, theatre.now_s, **limits))
        return made[-1]

    yield recorder
    for one in made:
        one.close()


def _kept(folder: Path, link: str) -> list[LinkLine]:
    return list(read_link(folder, link))


def test_recorded_bytes_are_read_back_with_direction_and_time(
    make: Make, folder: Path, theatre: Theatre
) -> None:
    recorder = make()
    recorder.on_bytes("tracker", SENT, b"BX 1801\r")
    theatre.moment_s = 2.5
    recorder.on_bytes("tracker", RECEIVED, bytes(range(256)))
    recorder.note("tracker", baud=115200)
    recorder.on_bytes("robot.master.eki", SENT, b"<Cmd/>")
    recorder.close()
    assert list_links(folder) == ("robot.master.eki", "tracker")
    first, second, note = _kept(folder, "tracker")
    assert (first.direction, first.data, first.theatre_time_s) == (SENT, b"BX 1801\r", 0.0)
    assert (second.direction, second.data, second.theatre_time_s) == (RECEIVED, bytes(range(256)), 2.5)
    assert (note.direction, note.note) == (None, {"baud": 115200})
    assert first.host_time < second.host_time < note.host_time


def test_bytes_from_another_process_get_a_theatre_time_between_two_calls(
    make: Make, folder: Path, theatre: Theatre
) -> None:
    recorder = make()
    recorder.on_earlier_bytes("rsi", [])
    began_ns = time.monotonic_ns()
    theatre.moment_s = 10.0
    recorder.on_earlier_bytes(
        "rsi", [PassedBytes(began_ns, RECEIVED, b"a"), PassedBytes(began_ns + 5000, SENT, b"b")]
    )
    recorder.close()
    first, second = _kept(folder, "rsi")
    assert 0.0 <= first.theatre_time_s <= second.theatre_time_s <= 10.0
    assert first.host_time < second.host_time


def test_a_link_keeps_its_newest_bytes_in_two_files_of_limited_size(make: Make, folder: Path) -> None:
    limit = 5000
    recorder = make(file_bytes=limit)
    for number in range(40):
        for _ in range(10):
            recorder.on_bytes("tracker", SENT, b"%04d" % number)
        recorder._write_waiting()
    recorder.close()
    assert len(list(folder.iterdir())) == 2
    assert all(path.stat().st_size <= limit for path in folder.iterdir())
    numbers = [int(line.data) for line in _kept(folder, "tracker")]
    assert numbers == sorted(numbers)
    assert numbers[-1] == 39
    assert len(numbers) > 0.5 * limit / 110  # at least one file's worth


def test_bytes_that_do_not_fit_into_the_queue_are_dropped_counted_and_noted(make: Make, folder: Path) -> None:
    recorder = make(queue_length=0)
    for _ in range(7):
        recorder.on_bytes("tracker", SENT, b"x")
    recorder.close()
    assert sum(int(line.note["dropped"]) for line in _kept(folder, "tracker")) == 7


def test_a_file_that_cannot_be_written_loses_only_its_own_bytes(make: Make, folder: Path) -> None:
    recorder = make()
    (folder / "tracker.a.jsonl.gz").mkdir()
    (folder / "tracker.b.jsonl.gz").mkdir()
    recorder.on_bytes("tracker", SENT, b"lost")
    recorder.on_bytes("eki", SENT, b"kept")
    recorder.close()
    assert [line.data for line in _kept(folder, "eki")] == [b"kept"]


def test_a_link_is_recorded_again_once_its_file_can_be_written_and_says_how_much_is_missing(
    make: Make, folder: Path
) -> None:
    recorder = make()
    for name in ("tracker.a.jsonl.gz", "tracker.b.jsonl.gz"):
        (folder / name).mkdir()
    for data in (b"one", b"two"):
        recorder.on_bytes("tracker", SENT, data)
    recorder.on_bytes("eki", SENT, b"later than both")
    eventually((folder / "eki.a.jsonl.gz").exists)
    for name in ("tracker.a.jsonl.gz", "tracker.b.jsonl.gz"):
        (folder / name).rmdir()
    recorder.on_bytes("tracker", SENT, b"three")
    recorder.close()
    lines = _kept(folder, "tracker")
    assert [line.data for line in lines if not line.note] == [b"three"]
    assert sum(int(line.note["dropped"]) for line in lines if line.note) == 2


def test_the_recorder_keeps_the_last_theatre_time_when_the_clock_ends(
    make: Make, folder: Path, theatre: Theatre
) -> None:
    theatre.moment_s = 3.0
    recorder = make()
    recorder.on_bytes("tracker", SENT, b"before")
    theatre.moment_s = -1.0
    recorder.on_bytes("tracker", SENT, b"after")
    recorder.close()
    assert [line.theatre_time_s for line in _kept(folder, "tracker")] == [3.0, 3.0]


def test_a_later_process_of_the_run_appends_after_a_torn_member(make: Make, folder: Path) -> None:
    file = folder / "tracker.a.jsonl.gz"
    ends = []
    for data in (b"one", b"two"):
        recorder = make()
        recorder.on_bytes("tracker", SENT, data)
        recorder.close()
        ends.append(file.stat().st_size)
    os.truncate(file, sum(ends) // 2)
    later = make()
    later.on_bytes("tracker", SENT, b"three")
    later.close()
    assert [line.data for line in _kept(folder, "tracker")] == [b"one", b"three"]


def test_a_file_that_expands_too_far_is_refused(
    run: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(flight_recorder, "LARGEST_CONTENT_BYTES", 100_000)
    (folder / "tracker.b.jsonl.gz").write_bytes(gzip.compress(bytes(100_001), mtime=0))
    refused = in_this_process(ronna_procedure, "bytes", run)
    assert "INP-001" in refused.stderr


@pytest.fixture
def run(make: Make, folder: Path, theatre: Theatre) -> Path:
    """A run whose links carried something at 1, 2 and 3 s."""
    recorder = make()
    for second, link in ((1.0, "tracker"), (2.0, "stereo.left.control"), (3.0, "tracker")):
        theatre.moment_s = second
        recorder.on_bytes(link, SENT, b"%d abcdef0123456789 deadbeef \x00\xff" % second)
    recorder.close()
    return folder.parent


@pytest.mark.parametrize(
    ("window", "seconds"),
    [
        ((), [1.0, 2.0, 3.0]),
        (("--link", "tracker"), [1.0, 3.0]),
        (("--link", "stereo"), [2.0]),
        (("--from", "1.5", "--to", "2.5"), [2.0]),
    ],
)
def test_a_window_is_selected_by_link_and_theatre_time(
    run: Path, window: tuple[str, ...], seconds: list[float]
) -> None:
    import json

    printed = in_this_process(ronna_procedure, "bytes", run, "--json", *window)
    assert printed.returncode == 0, printed.stderr
    assert [json.loads(line)["theatre_time_s"] for line in printed.stdout.splitlines()] == seconds


def test_an_unknown_link_is_refused_with_the_names_of_the_recorded_ones(run: Path) -> None:
    refused = in_this_process(ronna_procedure, "bytes", run, "--link", "lidar")
    assert refused.returncode == 2
    assert "stereo.left.control, tracker" in refused.stderr


def test_an_empty_window_names_the_recorded_span_and_a_reversed_one_is_refused(run: Path) -> None:
    empty = in_this_process(ronna_procedure, "bytes", run, "--link", "tracker", "--from", "7")
    assert (empty.returncode, empty.stdout) == (0, "")
    assert "tracker recorded 1.0 to 3.0 s" in empty.stderr
    reversed_ = in_this_process(ronna_procedure, "bytes", run, "--from", "3", "--to", "2")
    assert reversed_.returncode == 2
    assert "--from 3 --to 2" in reversed_.stderr


@pytest.mark.parametrize(
    "line",
    [
        '"host_time":"2026-11-20T23:58:31","theatre_time_s":1,"note":{}',
        '"host_time":"0001-01-01T00:00:00+23:59","theatre_time_s":1,"note":{}',
        '"host_time":"2026-11-20T23:58:31+00:00","theatre_time_s":1,"note":5',
        '"host_time":"2026-11-20T23:58:31+00:00","theatre_time_s":1,"note":{"a":"\\u001b[2J"}',
        '"host_time":"2026-11-20T23:58:31+00:00","theatre_time_s":1',
    ],
)
def test_a_line_that_the_recorder_did_not_write_is_skipped_or_shown_as_plain_text(
    run: Path, folder: Path, line: str
) -> None:
    (folder / "tracker.b.jsonl.gz").write_bytes(gzip.compress(f"{{{line}}}\n".encode(), mtime=0))
    (folder / "\x1b[2J.a.jsonl.gz").write_bytes(gzip.compress(f"{{{line}}}\n".encode(), mtime=0))
    printed = in_this_process(ronna_procedure, "bytes", run)
    assert printed.returncode == 0, printed.stderr
    assert "deadbeef" in printed.stdout
    assert "\x1b" not in printed.stdout


@pytest.mark.skipif(shutil.which("text2pcap") is None, reason="text2pcap is not installed")
def test_text2pcap_reads_the_printed_text_byte_for_byte(run: Path, tmp_path: Path) -> None:
    dump, capture = tmp_path / "dump.txt", tmp_path / "links.pcap"
    dump.write_text(in_this_process(ronna_procedure, "bytes", run).stdout)
    arguments = ("-a", "-D", "-t", "ISO", "-l", "147", "-F", "pcap")
    subprocess.run(["text2pcap", *arguments, dump, capture], check=True, capture_output=True)
    assert _packets(capture.read_bytes()) == [
        b"%d abcdef0123456789 deadbeef \x00\xff" % second for second in (1, 2, 3)
    ]


def _packets(capture: bytes) -> list[bytes]:
    packets, at = [], PCAP_HEAD
    while at < len(capture):
        _, _, length, _ = PACKET_HEAD.unpack_from(capture, at)
        at += PACKET_HEAD.size
        packets.append(capture[at : at + length])
        at += length
    return packets
