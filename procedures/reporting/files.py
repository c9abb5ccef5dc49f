"""Files stored with a report: images, tables, and the postoperative check."""

from __future__ import annotations

import base64
import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from procedures.journal.journal import Entry
from procedures.reporting.run_reading import RunReading
from procedures.reporting.tables import GuidePose, MotionRow, TargetRow
from ronna_hw.bounded_input import InputRefused, read_bounded, read_json_bytes
from ronna_hw.evidence.manifest import PICTURES_FOLDER, read_hashes
from ronna_hw.records import write_atomically

if TYPE_CHECKING:
    from procedures.postoperative.summary import PostoperativeCheck

REPORT_FOLDER = "report"
LARGEST_PICTURE_BYTES = 20_000_000  # ten times a case's largest
SUMMARY_FILE = "postoperative.json"
PICTURE = "postoperative-"  # the trajectory's name follows


class ReportFiles:
    """Writer for the files in `OUT/report`. Creates the folder if missing."""

    def __init__(self, out: Path) -> None:
        self._folder = out / REPORT_FOLDER
        self._folder.mkdir(parents=True, exist_ok=True)
        self.written: list[str] = []

    def text(self, name: str, text: str) -> Path:
        """Write a text file atomically and return its path."""
        path = self._folder / name
        write_atomically(path, text.encode())
        self.written.append(name)
        return path

    def drawing(self, name: str, svg: str, rows: Sequence[Mapping[str, object]]) -> None:
        """Write a drawing, and its data as a table of the same name."""
        self.text(f"{name}.svg", svg)
        self.table(name, rows)

    def table(self, name: str, rows: Sequence[Mapping[str, object]]) -> None:
        """Write a table; its first row has the names of all columns."""
        self.text(f"{name}.csv", _csv(rows))


def target_columns(rows: Sequence[TargetRow]) -> list[dict[str, object]]:
    """Return error, prediction and error budget of each target, with one column per source."""
    sources = list(dict.fromkeys(share.source for row in rows for share in row.predicted.budget))
    lines: list[dict[str, object]] = []
    for row in rows:
        shares = {share.source: share.rms_mm for share in row.predicted.budget}
        line: dict[str, object] = {"target": row.target, "depth_mm": row.depth_mm}
        line |= {f"predicted_{name}": getattr(row.predicted, name) for name in ("rms_mm", "limit_mm")}
        line["confidence"] = row.predicted.confidence
        line |= {"error_mm": row.error_mm, "lateral_mm": row.lateral_mm, "axial_mm": row.axial_mm}
        lines.append(line | {f"{one.replace(' ', '_')}_rms_mm": shares.get(one) for one in sources})
    return lines


def parts_columns(rows: Sequence[TargetRow]) -> list[dict[str, object]]:
    """Return the two parts of each target's error, as lengths and as vectors in the robot frame."""
    lines: list[dict[str, object]] = []
    for row in rows:
        line: dict[str, object] = {"target": row.target, "error_mm": row.error_mm}
        for part, length_mm in ({} if row.parts is None else row.parts.lengths_mm).items():
            vector = zip("xyz", getattr(row.parts, f"{part}_mm"), strict=True)
            line |= {f"{part}_error_mm": length_mm} | {f"{part}_{axis}_mm": value for axis, value in vector}
        lines.append(line)
    return lines


def pose_columns(poses: Sequence[GuidePose]) -> list[dict[str, object]]:
    """Return the six values of the pose in which the guide was held at each target."""
    names = ("x_mm", "y_mm", "z_mm", "alpha_deg", "beta_deg", "gamma_deg")
    lines: list[dict[str, object]] = []
    for one in poses:
        values = (*one.values.place_mm, *one.values.angles_deg)
        lines.append({"target": one.target, **dict(zip(names, values, strict=True))})
    return lines


def clearance_columns(motions: Sequence[MotionRow]) -> list[dict[str, object]]:
    """Return the clearance of each checked motion from the head, and its two closest bodies of all."""
    return [
        {"start": one.start, "end": one.end, "kind": one.kind, "head_mm": one.head_mm}
        | {name: getattr(one.closest, name, None) for name in ("first", "second", "distance_mm", "at")}
        for one in motions
    ]


def _csv(rows: Sequence[Mapping[str, object]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


class Picture(NamedTuple):
    """Picture of a run as a data URL."""

    name: str
    url: str


def load_pictures(reading: RunReading, prefix: str) -> tuple[Picture, ...]:
    """Load the pictures whose names begin with a prefix: of valid results, or of a step that left none.

    A question that was asked again has left another picture of the same thing.
    """
    gone, standing = set[str](), set[str]()
    for line in reading.run.lines(Entry.RESULT):
        of_line = {name for name in read_hashes(line, "pictures") if name.startswith(prefix)}
        (gone if line.get("record") in reading.run.superseded else standing).update(of_line)
    folder = reading.folder / PICTURES_FOLDER
    return tuple(
        Picture(_shown_name(path).removeprefix(prefix), data_url(picture))
        for path in sorted(folder.glob(f"{prefix}*.png"))
        if path.is_file()
        and (path.name in standing or not standing)
        and path.name not in gone
        and (picture := load_picture(reading, path)) is not None
    )


def _shown_name(path: Path) -> str:
    """Return what a picture shows, without the number of a second one of the same thing."""
    first, _, number = path.stem.rpartition("-")
    return first if number.isdecimal() and path.with_stem(first).exists() else path.stem


def load_picture(reading: RunReading, path: Path) -> bytes | None:
    """Load an image. If it is too large or unreadable, add a note and return None."""
    try:
        return read_bounded(path, LARGEST_PICTURE_BYTES, follow_links=False)
    except (OSError, InputRefused):
        reading.note(f"{path.name} is left out: it cannot be read or is too large for a picture")
        return None


def data_url(picture: bytes) -> str:
    """Encode a PNG as a data URL."""
    return "data:image/png;base64," + base64.b64encode(picture).decode()


@dataclass(frozen=True)
class PostoperativeResult:
    """Findings of a postoperative check, and one PNG for each trajectory name."""

    found: PostoperativeCheck
    pictures: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def shown(self) -> tuple[Picture, ...]:
        """Images by the names of their trajectories."""
        names = (one.id for one in self.found.trajectories)
        return tuple(Picture(name, data_url(self.pictures[name])) for name in names if name in self.pictures)


def store_check(folder: Path, after: PostoperativeResult) -> None:
    """Store a postoperative check in a folder, creating it if missing. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / SUMMARY_FILE, after.found.model_dump_json(by_alias=True, indent=1).encode())
    for name, picture in after.pictures.items():
        write_atomically(folder / f"{PICTURE}{name}.png", picture)


def load_check(reading: RunReading) -> PostoperativeResult | None:
    """Load the postoperative check of a run, or return None if missing or unreadable (with a note)."""
    folder = reading.folder / REPORT_FOLDER
    if not (folder / SUMMARY_FILE).exists():
        return None
    from procedures.postoperative.summary import PostoperativeCheck  # a case needs none of it

    try:
        found = PostoperativeCheck.model_validate_json(read_json_bytes(folder / SUMMARY_FILE))
    except (OSError, ValueError):
        reading.note(f"{SUMMARY_FILE}, the check after the operation, cannot be read")
        return None
    paths = (path for path in sorted(folder.glob(f"{PICTURE}*.png")) if path.is_file())
    pictures = {path.stem.removeprefix(PICTURE): load_picture(reading, path) for path in paths}
    return PostoperativeResult(found, {name: one for name, one in pictures.items() if one is not None})
