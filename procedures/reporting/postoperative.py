"""The postoperative check in a run's report: kept in its folder, shown as one section."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from procedures.postoperative.summary import PostoperativeCheck
from procedures.reporting.files import REPORT_FOLDER
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.records import write_whole

SUMMARY_FILE = "postoperative.json"


@dataclass(frozen=True)
class AfterTheOperation:
    """What was found, and a PNG per trajectory by file name."""

    found: PostoperativeCheck
    pictures: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def shown(self) -> list[tuple[str, str]]:
        """Name and picture, as embedded in a page."""
        return [
            (name.removeprefix("postoperative-").removesuffix(".png"), _inside(picture))
            for name, picture in self.pictures.items()
        ]


def keep_check(run: Path, after: AfterTheOperation) -> None:
    """Store it in a run's folder, or where its report is made."""
    folder = run / REPORT_FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / SUMMARY_FILE, after.found.model_dump_json(by_alias=True, indent=1).encode())
    for name, picture in after.pictures.items():
        write_whole(folder / name, picture)


def kept_check(run: Path) -> AfterTheOperation | None:
    """What `keep_check` stored; None if missing or unreadable."""
    folder = run / REPORT_FOLDER
    try:
        found = PostoperativeCheck.model_validate_json(read_json_bytes(folder / SUMMARY_FILE))
    except (OSError, ValueError):
        return None
    pictures = {
        path.name: path.read_bytes() for path in sorted(folder.glob("postoperative-*.png")) if path.is_file()
    }
    return AfterTheOperation(found, pictures)


def _inside(picture: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(picture).decode()
