"""Raw readings of a run for other programs: images, tracker frames, arm states, and their extent.

They are what the run's tape keeps for replay: every device answer that a result is based on, lossless. A
folder states its extent, because a later program of the run may not have written its own readings.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TextIO

from pydantic import BaseModel, Field

from procedures.engine.errors import NotRecorded
from procedures.engine.replay.recorded_answers import BEGINS, RecordedReading, iterate_readings
from procedures.exchange.errors import NOT_WRITABLE, NOTHING_TO_EXPORT
from procedures.journal.journal import JOURNAL_FILE
from ronna_hw.arguments import require_path
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.devices.readings import ArmReading, CameraImage, StereoReading, TrackerFrame
from ronna_hw.evidence.journal_reading import Line, read_chain_until_break
from ronna_hw.evidence.manifest import RAW_FOLDER
from ronna_hw.host.files import remove_folder
from ronna_hw.recording.reading_tape import READINGS_FILE, READINGS_FOLDER
from ronna_hw.records import PARTIAL

EXTENT_FILE = "extent.json"
WRITES_ALL = "ronna-procedure raw RUN --out DIR writes all"
MOST_RAW_BYTES = 2_000_000_000  # per run, as on its tape
PICTURES_FOLDER = "pictures"
TABLES = {
    "pictures.csv": (
        *("file", "step", "theatre_time_s", "side", "serial", "validity", "offset_x_px", "offset_y_px"),
        "missing_packets",
    ),
    "tracker.csv": (
        *("frame", "step", "theatre_time_s", "device_frame", "what", "name", "validity"),
        *("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz", "fit_error_mm", "markers_used"),
    ),
    "arm.csv": (
        *("step", "theatre_time_s", "device", "call", "validity", "moving"),
        *(f"A{axis}_rad" for axis in range(1, 7)),
    ),
}
Value = str | int | float | bool | None


@dataclass(frozen=True)
class RawReading:
    """Reading from a device during a step: a `StereoReading`, a `TrackerFrame` or an `ArmReading`."""

    step: str
    device: str
    call: str
    theatre_time_s: float
    value: StereoReading | TrackerFrame | ArmReading


def raw_readings(run: Path | str) -> Iterator[RawReading]:
    """Yield the readings in a run folder, in order, up to the first damaged one. Raises ARG-001, PRO-024."""
    for step, one in iterate_steps(require_path(run, "the folder of the run")):
        value = one.load()
        if isinstance(value, StereoReading | TrackerFrame | ArmReading):
            yield RawReading(step, one.device, one.call, one.theatre_time_s, value)


def iterate_steps(run: Path) -> Iterator[tuple[str, RecordedReading]]:
    """Yield each answer on a run's tape with its step, without loading pixels. Raises PRO-024."""
    if not (run / READINGS_FOLDER / READINGS_FILE).is_file():
        raise NotRecorded(
            f"{run} is not a run with readings",
            expected=f"the folder of one run, with {JOURNAL_FILE} and {READINGS_FOLDER}/{READINGS_FILE}",
            action="ronna-procedure list shows the runs in a folder.",
        )
    chain, _ = read_chain_until_break(run / JOURNAL_FILE)
    steps = {
        line["sequence"]: str(line.get("step", "home")) for line in chain.lines if line["entry"] in BEGINS
    }
    for one in iterate_readings(run):
        yield steps.get(one.section, ""), one


def write_raw(run: Path | str, out: Path | str, most_bytes: int = MOST_RAW_BYTES) -> tuple[Path, bool]:
    """Write the readings as PNG and CSV into the new folder `out`, and record their extent.

    Returns the folder and whether it is complete: about `most_bytes` are written at most. Raises EXC-002,
    EXC-003, PRO-024, and then leaves nothing behind; ARG-001 for what is no path.
    """
    run, out = require_path(run, "the folder of the run"), require_path(out, "the new folder")
    if out.exists():
        raise NOT_WRITABLE(f"{out} already exists", action="Give a new folder.")
    partial_folder = out.with_name(f".{out.name}{PARTIAL}")
    try:
        remove_folder(partial_folder)
        (partial_folder / PICTURES_FOLDER).mkdir(parents=True)
        lines = len(read_chain_until_break(run / JOURNAL_FILE)[0].lines)
        whole = _write_all(run, partial_folder, most_bytes)
        extent = RawExtent(journal_lines=lines, whole=whole).model_dump_json(by_alias=True)
        (partial_folder / EXTENT_FILE).write_text(f"{extent}\n", encoding="utf-8")
        os.replace(partial_folder, out)
    except OSError as error:
        raise NOT_WRITABLE(f"cannot write into {out}: {error.strerror}") from error
    finally:
        remove_folder(partial_folder)
    return out, whole


class RawExtent(BaseModel, frozen=True, extra="forbid", strict=True):
    """Fields of `extent.json`."""

    schema_version: Literal[1] = Field(default=1, alias="schema")
    journal_lines: int = Field(
        ge=0, description="Length of the journal then: readings of later steps are missing."
    )
    whole: bool = Field(description="Whether everything up to there fitted.")


def missing_in_raw(run: Path, lines: tuple[Line, ...]) -> str | None:
    """Describe what a run's folder of raw readings lacks, compared with the journal `lines`.

    None if nothing is missing, or if there is no such folder.
    """
    folder = run / RAW_FOLDER
    if not folder.is_dir():
        return None
    try:
        extent = RawExtent.model_validate_json(read_json_bytes(folder / EXTENT_FILE, follow_links=False))
    except (OSError, ValueError):
        return f"{RAW_FOLDER}/ does not state how far its readings extend"
    later_sections = [line for line in lines[extent.journal_lines :] if line["entry"] in BEGINS]
    if later_sections:
        first = later_sections[0].get("step", "home")
        return f"{RAW_FOLDER}/ is from before the run was resumed: readings from {first} on are missing"
    return None if extent.whole else f"{RAW_FOLDER}/ was full: the last readings are missing"


def _write_all(run: Path, folder: Path, most_bytes: int) -> bool:
    """Write all tables and images. Return whether they fitted within the size limit."""
    files: dict[str, TextIO] = {}
    pictures, frames, size, readings = 0, 0, 0, 0
    try:
        for name, columns in TABLES.items():
            files[name] = (folder / name).open("w", encoding="utf-8", newline="")
            csv.writer(files[name], lineterminator="\n").writerow(columns)
        for one in raw_readings(run):
            readings += 1
            if size + sum(file.tell() for file in files.values()) > most_bytes:
                return False
            rows: list[Sequence[Value]] = []
            if isinstance(one.value, StereoReading):
                pictures += 1
                for side, image in (("left", one.value.left), ("right", one.value.right)):
                    if image is not None:
                        path = folder / PICTURES_FOLDER / f"{pictures:05d}-{side}.png"
                        size += _write_picture(path, image)
                        rows.append(_picture_row(path, side, image, one))
                name = "pictures.csv"
            elif isinstance(one.value, TrackerFrame):
                frames += 1
                rows += _frame_rows(frames, one.value, one)
                name = "tracker.csv"
            else:
                state = (one.value.validity.value, one.value.moving, *one.value.joints_rad)
                rows.append((one.step, one.theatre_time_s, one.device, one.call, *state))
                name = "arm.csv"
            csv.writer(files[name], lineterminator="\n").writerows(rows)
    finally:
        for file in files.values():
            file.close()
    if not readings:
        raise NOTHING_TO_EXPORT(
            f"{run.name} has no readings", action="Give a run that reached a measurement."
        )
    return True


def _write_picture(path: Path, image: CameraImage) -> int:
    """Write the image as received, with 8 or 16 bits per pixel, and return the number of bytes."""
    import cv2  # only here: `show` and `verify` read the extent alone

    _, content = cv2.imencode(".png", image.pixels)
    path.write_bytes(content.tobytes())
    return len(content)


def _picture_row(path: Path, side: str, image: CameraImage, reading: RawReading) -> Sequence[Value]:
    taken = (f"{PICTURES_FOLDER}/{path.name}", reading.step, reading.theatre_time_s, side, image.serial)
    area = (image.area.offset_x, image.area.offset_y)
    return (*taken, image.validity.value, *area, image.missing_packets)


def _frame_rows(number: int, frame: TrackerFrame, reading: RawReading) -> list[Sequence[Value]]:
    """Build one row for each tool and stray marker, or a single row for an empty frame."""
    head = (number, reading.step, reading.theatre_time_s, frame.stamp.device_clock)
    rows: list[Sequence[Value]] = []
    for one in frame.tools:
        pose = (*(one.position_mm or (None,) * 3), *(one.rotation or (None,) * 4))
        used = None if one.markers_used is None else "".join(str(int(flag)) for flag in one.markers_used)
        rows.append((*head, "tool", one.tool, one.validity.value, *pose, one.fit_error_mm, used))
    rows += [
        (*head, "stray", number, one.validity.value, *one.position_mm, *(None,) * 6)
        for number, one in enumerate(frame.strays, 1)
    ]
    return rows or [(*head, "nothing", None, frame.validity.value, *(None,) * 9)]
