"""How far the raw readings in a folder reach: a later program of the run may not have written its own."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from procedures.engine.replay.recorded_answers import BEGINS
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.evidence.journal_reading import Line
from ronna_hw.evidence.seal import RAW_FOLDER

EXTENT_FILE = "extent.json"
WRITES_ALL = "ronna-procedure raw RUN --out DIR writes all"


class RawExtent(BaseModel):
    """The content of `extent.json`."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    schema_version: Literal[1] = Field(default=1, alias="schema")
    journal_lines: int = Field(
        ge=0, description="Length of the journal then: readings of later steps are missing."
    )
    whole: bool = Field(description="Whether everything up to there fitted.")


def write_extent(folder: Path, extent: RawExtent) -> None:
    """Write it into a folder of raw readings. Raises OSError."""
    (folder / EXTENT_FILE).write_text(f"{extent.model_dump_json(by_alias=True)}\n", encoding="utf-8")


def missing_in_raw(run: Path, lines: tuple[Line, ...]) -> str | None:
    """Describe what is missing from the run's own folder of raw readings; `lines` are those of its journal.

    None if nothing is missing, or if there is no such folder.
    """
    folder = run / RAW_FOLDER
    if not folder.is_dir():
        return None
    try:
        extent = RawExtent.model_validate_json(read_json_bytes(folder / EXTENT_FILE, linked=False))
    except (OSError, ValueError):
        return f"{RAW_FOLDER}/ does not state how far its readings extend"
    since = [line for line in lines[extent.journal_lines :] if line["entry"] in BEGINS]
    if since:
        first = since[0].get("step", "home")
        return f"{RAW_FOLDER}/ is from before the run was resumed: readings from {first} on are missing"
    return None if extent.whole else f"{RAW_FOLDER}/ was full: the last readings are missing"
