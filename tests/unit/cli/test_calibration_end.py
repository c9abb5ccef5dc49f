"""The closing messages of a calibration."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from procedures.calibration.errors import TooFewPoses
from procedures.cli.arm.files import KIND
from procedures.cli.calibrating.calibration import observe, show
from procedures.cli.case.request import TheatreRequest
from procedures.reporting.calibration.figures import Figure, RecordFigures
from procedures.steps.calibration.recipe import Calibrated, Recipe


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


def test_remarks_on_the_measurements_are_reported_also_if_these_yield_no_calibration(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def measured(*_: object, judge: Callable[[Any], None], **__: object) -> None:
        judge(SimpleNamespace(case=None))

    def too_few(_looks: object) -> None:
        raise TooFewPoses("too few measurements")

    monkeypatch.setattr("procedures.cli.calibrating.calibration.run_steps", measured)
    kind = replace(KIND, observed=lambda _case: None, remarks=lambda _case: ("30 x no sphere in view",))
    recipe = Recipe(of=Calibrated.ARM, looks=60, more=12)
    with pytest.raises(TooFewPoses):
        observe(kind, recipe, TheatreRequest(), tmp_path, too_few)
    assert capsys.readouterr().err == "30 x no sphere in view\n"
