"""The postoperative check in a run's report: kept in its folder, shown as one section."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from procedures.postoperative.summary import PostoperativeCheck
from procedures.reporting.embedded import embedded, picture_of
from procedures.reporting.files import REPORT_FOLDER
from procedures.reporting.run_reading import RunReading
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.records import write_whole

SUMMARY_FILE = "postoperative.json"
PICTURE = "postoperative-"  # the trajectory's name follows


@dataclass(frozen=True)
class AfterTheOperation:
    """What was found, and a PNG per trajectory by its name."""

    found: PostoperativeCheck
    pictures: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def shown(self) -> list[tuple[str, str]]:
        """Name and picture, as embedded in a page."""
        names = [one.id for one in self.found.trajectories]
        return [(name, embedded(self.pictures[name])) for name in names if name in self.pictures]


def keep_check(folder: Path, after: AfterTheOperation) -> None:
    """Store it in this folder, creating it if missing. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / SUMMARY_FILE, after.found.model_dump_json(by_alias=True, indent=1).encode())
    for name, picture in after.pictures.items():
        write_whole(folder / f"{PICTURE}{name}.png", picture)


def kept_check(reading: RunReading) -> AfterTheOperation | None:
    """What a run keeps of it: None without one, and with a note for one that cannot be read."""
    folder = reading.folder / REPORT_FOLDER
    try:
        found = PostoperativeCheck.model_validate_json(read_json_bytes(folder / SUMMARY_FILE))
    except FileNotFoundError:
        return None
    except (OSError, ValueError):
        reading.note(f"{SUMMARY_FILE}, the check after the operation, cannot be read")
        return None
    paths = (path for path in sorted(folder.glob(f"{PICTURE}*.png")) if path.is_file())
    pictures = {path.stem.removeprefix(PICTURE): picture_of(reading, path) for path in paths}
    return AfterTheOperation(found, {name: one for name, one in pictures.items() if one is not None})
