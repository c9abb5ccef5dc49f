"""Raw readings of a run as files: lossless, bounded, sealed with the run, and in no export."""

from __future__ import annotations

import csv
import json
import signal
from pathlib import Path

import cv2
import numpy as np
import pytest
from coded_errors import raises
from user_commands import in_this_process

from procedures.cli.procedure import app
from procedures.cli.runs.commands import raw_command
from procedures.engine.errors import NotRecorded
from procedures.engine.replay.recorded_answers import section_follower
from procedures.exchange.errors import NOT_WRITABLE, NOTHING_TO_EXPORT
from procedures.exchange.raw_readings import EXTENT_FILE, TABLES, missing_in_raw, raw_readings, write_raw
from procedures.journal.journal import Entry, Journal
from procedures.runs.finishing import seal_run
from procedures.runs.request import CaseProcedure, RunRequest
from procedures.runs.request_file import write_request
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import (
    AreaOfInterest,
    ArmReading,
    CameraImage,
    Stamp,
    StereoReading,
    StrayReading,
    ToolReading,
    TrackerFrame,
    Validity,
)
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.evidence.journal_reading import RUN_CHANGED, read_chain
from ronna_hw.evidence.manifest import RAW_FOLDER, hash_files_at_closing, seal
from ronna_hw.recording.reading_tape import READINGS_FILE, READINGS_FOLDER, ReadingTape

STAMP = Stamp(7, 4242, 1.25)
FRAME = TrackerFrame(
    STAMP,
    Validity.OK,
    (
        ToolReading("robot_frame", Validity.OK, (1.0, 0.0, 0.0, 0.0), (1.5, -2.5, -1000.0), 0.12),
        ToolReading("other", Validity.MISSING, None, None, None),
    ),
    (StrayReading((10.0, 20.0, -1100.0), Validity.OK),),
)
ARM = ArmReading(STAMP, Validity.OK, (0.1, 0.2, 0.3, 0.4, 0.5, 0.6), None, False)


def image(serial: str, bits: int) -> CameraImage:
    kind = np.uint8 if bits == 8 else np.uint16
    pixels = np.random.default_rng(bits).integers(0, 2**bits, size=(30, 40)).astype(kind)
    return CameraImage(STAMP, Validity.OK, serial, pixels, AreaOfInterest(16, 32, 40, 30), 0)


PAIR = StereoReading(STAMP, Validity.OK, image("L1", 8), image("R1", 12))


def run_of(folder: Path, *answers: tuple[str, str, object], keep_raw: bool = False) -> Path:
    """A finished run of one step with these answers."""
    folder.mkdir()
    write_request(RunRequest(procedure=CaseProcedure(keep_raw=keep_raw)), folder)
    tape = ReadingTape(folder / READINGS_FOLDER, lambda: 3.5, {"paced": True})
    journal = Journal(folder, section_follower(tape))
    journal.write(Entry.OPENED, 0.0, run=folder.name)
    journal.write(Entry.INTENT, 0.0, step="registration:T1")
    for device, call, value in answers:
        tape.keep(device, call, Lifecycle.ACTIVE, value)
    tape.close()
    files = hash_files_at_closing(folder)
    journal.write(Entry.CLOSED, 0.0, outcome="done", files=files)
    journal.close()
    seal(folder, files)
    return folder


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return run_of(
        tmp_path / "20261121T000000-0000",
        ("tracker", "read_frame", FRAME),
        ("stereo", "grab_pair", PAIR),
        ("robot.master", "read_state", ARM),
        ("stereo", "activate", None),
    )


def rows(folder: Path, name: str) -> list[dict[str, str]]:
    with (folder / name).open() as file:
        return list(csv.DictReader(file))


def test_pictures_are_written_losslessly_with_their_sensor_offset(run: Path, tmp_path: Path) -> None:
    folder, whole = write_raw(run, tmp_path / "raw")
    assert whole
    said = rows(folder, "pictures.csv")
    assert [(row["file"], row["side"], row["serial"], row["step"]) for row in said] == [
        ("pictures/00001-left.png", "left", "L1", "registration:T1"),
        ("pictures/00001-right.png", "right", "R1", "registration:T1"),
    ]
    assert {(row["offset_x_px"], row["offset_y_px"], row["theatre_time_s"]) for row in said} == {
        ("16", "32", "3.5")
    }
    for row, side in zip(said, (PAIR.left, PAIR.right), strict=True):
        picture = cv2.imread(str(folder / row["file"]), cv2.IMREAD_UNCHANGED)
        assert side is not None
        assert picture.dtype == side.pixels.dtype
        np.testing.assert_array_equal(picture, side.pixels)


def test_the_tables_have_a_row_for_each_tool_each_stray_marker_and_each_arm_reading(
    run: Path, tmp_path: Path
) -> None:
    folder, _ = write_raw(run, tmp_path / "raw")
    seen, missing, stray = rows(folder, "tracker.csv")
    assert (seen["what"], seen["name"], seen["x_mm"], seen["z_mm"], seen["qw"], seen["device_frame"]) == (
        *("tool", "robot_frame", "1.5", "-1000.0", "1.0"),
        "4242",
    )
    assert (missing["name"], missing["validity"], missing["x_mm"]) == ("other", Validity.MISSING.value, "")
    assert (stray["what"], stray["y_mm"]) == ("stray", "20.0")
    (arm,) = rows(folder, "arm.csv")
    assert [arm[f"A{axis}_rad"] for axis in (1, 6)] == ["0.1", "0.6"]


def test_raw_readings_returns_the_drivers_own_types(run: Path) -> None:
    frame, pair, arm = (one.value for one in raw_readings(str(run)))
    assert (frame, arm) == (FRAME, ARM)
    assert isinstance(pair, StereoReading)
    assert PAIR.left is not None
    assert pair.left is not None
    np.testing.assert_array_equal(pair.left.pixels, PAIR.left.pixels)


@pytest.mark.parametrize("kind", [Path, str])
def test_a_folder_of_runs_is_not_accepted_as_a_run(kind: type[Path | str], run: Path) -> None:
    with pytest.raises(NotRecorded, match=f"PRO-024: {run.parent} is not a run with readings; .* list shows"):
        next(raw_readings(kind(run.parent)))


def test_the_disk_use_is_bounded_and_truncation_is_reported(tmp_path: Path) -> None:
    many = run_of(tmp_path / "many", *(("stereo", "grab_pair", PAIR) for _ in range(20)))
    folder, whole = write_raw(many, tmp_path / "raw", most_bytes=10_000)
    assert not whole
    assert sum(path.stat().st_size for path in folder.rglob("*.png")) < 15_000
    assert len(rows(folder, "pictures.csv")) == len(list(folder.rglob("*.png")))


def test_raw_readings_kept_in_a_run_are_sealed_with_it(run: Path) -> None:
    write_raw(run, run / RAW_FOLDER)
    closed = json.loads((run / "journal.jsonl").read_text().splitlines()[-1])["files"]
    seal(run, closed)
    assert inspect_run(run).problems == ()
    picture = run / RAW_FOLDER / "pictures" / "00001-left.png"
    picture.write_bytes(picture.read_bytes()[:-1])
    assert [str(one) for one in inspect_run(run).problems] == [
        f"{RAW_FOLDER}/pictures/00001-left.png: changed"
    ]


@pytest.mark.parametrize("keep_raw", [True, False])
def test_sealing_writes_raw_readings_only_when_requested_and_the_run_stays_intact(
    keep_raw: bool, tmp_path: Path
) -> None:
    run = run_of(tmp_path / "20261121T000000-0001", ("tracker", "read_frame", FRAME), keep_raw=keep_raw)
    for _ in range(2):  # a run that is taken up again ends twice
        seal_run(run)
        assert (run / RAW_FOLDER / "tracker.csv").exists() == keep_raw
        assert inspect_run(run).problems == ()


def test_existing_raw_readings_are_kept_when_they_cannot_be_rewritten(tmp_path: Path) -> None:
    run = run_of(tmp_path / "20261121T000000-0001", ("tracker", "read_frame", FRAME), keep_raw=True)
    seal_run(run)
    (run / READINGS_FOLDER / READINGS_FILE).unlink()
    seal_run(run)
    assert (run / RAW_FOLDER / "tracker.csv").exists()


@pytest.mark.parametrize("at_once", [True, False])
def test_sealing_at_once_or_interrupted_keeps_the_existing_raw_readings(
    at_once: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def endless(*_: object) -> bool:
        signal.raise_signal(signal.SIGINT)
        raise AssertionError("it went on")

    run = run_of(tmp_path / "20261121T000000-0001", ("tracker", "read_frame", FRAME), keep_raw=True)
    seal_run(run)
    monkeypatch.setattr("procedures.exchange.raw_readings._write_all", endless)
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)  # as when everything is ending
    try:
        seal_run(run, at_once=at_once)
    finally:
        signal.signal(signal.SIGINT, handler)
    assert f"ronna-procedure raw {run}" in capsys.readouterr().err
    assert (run / RAW_FOLDER / "tracker.csv").exists()
    assert inspect_run(run).problems == ()


def test_readings_of_a_later_session_missing_from_raw_are_reported(tmp_path: Path) -> None:
    run = run_of(tmp_path / "20261121T000000-0001", ("tracker", "read_frame", FRAME), keep_raw=True)
    seal_run(run)
    said = [in_this_process(app, command, run) for command in ("show", "verify")]
    assert not any(f"{RAW_FOLDER}/" in one.stdout for one in said)
    journal = Journal.reopen_run(run, read_chain(run / "journal.jsonl"))
    journal.write(Entry.RESTARTED, 4.0)
    journal.write(Entry.INTENT, 4.0, step="relocalization:T2")
    journal.write(Entry.CLOSED, 5.0, outcome="interrupted", files=hash_files_at_closing(run))
    journal.close()
    seal_run(run, at_once=True)
    for command in ("show", "verify"):
        done = in_this_process(app, command, run)
        assert done.returncode == 0
        assert (
            "raw/ is from before the run was resumed: readings from relocalization:T2 on are missing"
            in done.stdout
        )


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"schema": 2, "journal_lines": 9, "whole": true}'])
def test_raw_readings_without_a_valid_extent_are_reported(text: str, run: Path) -> None:
    folder, _ = write_raw(run, run / RAW_FOLDER)
    lines = read_chain(run / "journal.jsonl").lines
    assert missing_in_raw(run, lines) is None
    (folder / EXTENT_FILE).write_text(text)
    assert missing_in_raw(run, lines) == "raw/ does not state how far its readings extend"


def test_raw_readings_truncated_for_lack_of_space_are_reported(run: Path) -> None:
    write_raw(run, run / RAW_FOLDER, most_bytes=100)
    assert "full" in str(missing_in_raw(run, read_chain(run / "journal.jsonl").lines))


def test_the_raw_command_refuses_a_changed_run(run: Path, tmp_path: Path) -> None:
    tape = run / READINGS_FOLDER / READINGS_FILE
    tape.write_bytes(tape.read_bytes().replace(b"-1000.0", b"-1001.0"))
    with raises(RUN_CHANGED, match=r"PRO-033.*readings\.jsonl: changed"):
        raw_command(run, tmp_path / "raw")
    assert not (tmp_path / "raw").exists()


def test_an_existing_output_folder_is_refused(run: Path, tmp_path: Path) -> None:
    with raises(NOT_WRITABLE, match=r"EXC-002: .* already exists"):
        write_raw(run, tmp_path)


@pytest.mark.parametrize("spoilt", ["none", "empty", "pixels"])
def test_unreadable_readings_leave_no_output(spoilt: str, run: Path, tmp_path: Path) -> None:
    tape = run / READINGS_FOLDER
    if spoilt == "none":
        (tape / READINGS_FILE).unlink()
    elif spoilt == "empty":
        (tape / READINGS_FILE).write_text('{"opening": {}}\n')
    else:
        (tape / "pixels.bin").write_bytes(b"tea")
    out = tmp_path / "out" / "raw"
    out.parent.mkdir()
    with raises(NotRecorded, NOTHING_TO_EXPORT):
        write_raw(run, out)
    assert list(out.parent.iterdir()) == []


def test_every_row_is_as_wide_as_its_header(run: Path, tmp_path: Path) -> None:
    folder, _ = write_raw(run, tmp_path / "raw")
    for name, columns in TABLES.items():
        for line in (folder / name).read_text().splitlines():
            assert len(line.split(",")) == len(columns)
