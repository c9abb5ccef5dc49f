"""Pictures of a report: of what stands, each thing once."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from procedures.reporting.files import PICTURES_FOLDER, load_pictures


def reading_of(folder: Path, *files: str, kept: tuple[str, ...] = ()) -> Any:
    (folder / PICTURES_FOLDER).mkdir()
    for name in files:
        (folder / PICTURES_FOLDER / name).write_bytes(b"picture")
    line = {"record": "03", "pictures": dict.fromkeys(kept, "0" * 64)}
    run = SimpleNamespace(superseded=frozenset(), lines=lambda _entry: [line] if kept else [])
    return SimpleNamespace(run=run, folder=folder, note=lambda _text: None)


@pytest.mark.parametrize(
    ("kept", "shown"),
    [
        (("plan-T1-2.png", "plan-T2-2.png"), ["T1", "T2"]),  # asked twice: the picture of the result
        ((), ["T1", "T1", "T2", "T2"]),  # the step has ended without a result
    ],
)
def test_a_question_asked_again_leaves_one_picture_of_each_trajectory(
    tmp_path: Path, kept: tuple[str, ...], shown: list[str]
) -> None:
    files = ("plan-T1.png", "plan-T1-2.png", "plan-T2.png", "plan-T2-2.png")
    assert [one.name for one in load_pictures(reading_of(tmp_path, *files, kept=kept), "plan-")] == shown
