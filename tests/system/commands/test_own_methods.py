"""The methods of the how-to page work, and an unusable method leaves nothing behind."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from documented import write_files
from user_commands import in_this_process

from studies import plugin_trial as trial
from studies.cli import app

PAGE = "docs/how-to/research/own-methods.md"


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """A folder of one's own with the files of the page, whose modules are forgotten afterwards."""
    write_files(PAGE, tmp_path)
    yield tmp_path
    for file in tmp_path.glob("*.py"):
        sys.modules.pop(file.stem, None)


@pytest.mark.slow
def test_the_pairing_of_the_page_is_compared_with_ours_with_its_bounds(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    arguments = ("--runs", "1", "--method", "my_pairing:by_distances", "--method", "count", "--json")
    done = in_this_process(app, "correspondence", *arguments, "--workers", "1", "--out", folder / "out")
    assert done.returncode == 0, done.stderr
    table = json.loads(done.stdout)["tables"][0]
    rows = [dict(zip(table["columns"], row, strict=True)) for row in table["rows"]]
    mine = [row for row in rows if row["method"] == "my_pairing:by_distances"]
    assert len(mine) == len(rows) / 2 == 6
    assert {row["false, 95 %"] for row in mine if row["false %"] == 0.0} == {"at most 18"}


def test_an_unusable_method_leaves_no_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    # In a process of its own for the first only: the others have it tried by the same function.
    for command in ("correspondence", "registration", "localization"):
        done = in_this_process(app, command, "--method", "my_strategy:Halfway", "--out", folder / "out")
        assert done.returncode == 2
        assert "STU-012: my_strategy:Halfway cannot be called as a " in done.stderr
        monkeypatch.setattr(
            trial, "try_in_subprocess", lambda kind, text, _tell: trial.try_plugin(kind, text)
        )
    assert [one for one in sorted(folder.iterdir()) if one.name != "__pycache__"] == before
