"""The closing message of a calibration."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from procedures.cli.calibrating.calibration import show

KIND = cast("Any", SimpleNamespace(figures=lambda _payload: (), warnings=lambda _payload: ()))


@pytest.mark.parametrize(
    ("written", "told"), [(Path("new.toml"), "written to new.toml"), (None, "or use --write")]
)
def test_the_message_names_the_written_file_or_how_to_write_one(
    written: Path | None, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    show(KIND, {"calibration": "tool-tip"}, Path("out"), written=written, as_json=False)
    said = capsys.readouterr().err
    assert told in said
    assert ("--write" in said) is (written is None)
