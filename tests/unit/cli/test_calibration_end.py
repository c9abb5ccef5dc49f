"""What a calibration says at its end."""

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
def test_what_was_written_is_named_and_else_how_to_write_it(
    written: Path | None, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    show(KIND, {"calibration": "tool-tip"}, Path("out"), written=written, as_json=False)
    said = capsys.readouterr().err
    assert told in said
    assert ("--write" in said) is (written is None)
