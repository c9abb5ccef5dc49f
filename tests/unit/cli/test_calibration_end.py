"""The closing message of a calibration."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from procedures.cli.calibrating.calibration import show
from procedures.reporting.calibration.figures import Figure, RecordFigures


class NoFigures(RecordFigures):
    def quality(self) -> Iterator[Figure]:
        yield from ()


@pytest.mark.parametrize(
    ("written", "told"), [(Path("new.toml"), "written to new.toml"), (None, "or use --write")]
)
def test_the_message_names_the_written_file_or_how_to_write_one(
    written: Path | None, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = NoFigures(calibration="tool-tip", created="", expires="")
    show(figures, Path("out"), written=written, as_json=False)
    said = capsys.readouterr().err
    assert told in said
    assert ("--write" in said) is (written is None)
