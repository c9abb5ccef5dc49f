"""`ronna-procedure calibrate` as a user runs it: from the how-to pages, on stored looks, with bad input."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest
from documented import commands_of, run_all
from user_commands import Commands, in_this_process, one_error

from benchmarks.frame_looks import FrameCell
from procedures.calibration.tracker_frame.looks import LOOKS_FILE
from procedures.cli.procedure import app


@pytest.fixture
def looks(tmp_path: Path) -> Path:
    """Looks at the reference frame as a calibration leaves them."""
    folder = tmp_path / "before"
    folder.mkdir()
    observed = FrameCell.of(3, calibrated=True).looks(15, 5)
    (folder / LOOKS_FILE).write_text(observed.model_dump_json(by_alias=True))
    return folder


def test_stored_looks_are_computed_again_into_a_record_for_the_theatre_file(
    looks: Path, tmp_path: Path
) -> None:
    run = ("calibrate", "tracker-frame", "--from", looks, "--out", tmp_path / "out")
    done = in_this_process(app, *run, "--json")
    assert done.returncode == 0, done.stderr
    payload = json.loads(done.stdout)
    records = tomllib.loads((Path(payload["folder"]) / "calibration.toml").read_text())["calibration"]
    assert records["tracker_frame"]["identifier"] == payload["calibration"]
    assert payload["error_mm"] < 0.05
    shown = in_this_process(app, *run)
    assert "the arm's own share, mm" in shown.stdout


def test_a_record_in_metres_is_refused_by_the_number(looks: Path, tmp_path: Path) -> None:
    stored = json.loads((looks / LOOKS_FILE).read_text())
    stored["start"]["tool_from_marker"]["translation_mm"] = [-0.15, 0.0, -0.14]
    (looks / LOOKS_FILE).write_text(json.dumps(stored))
    done = in_this_process(app, "calibrate", "tracker-frame", "--from", looks, "--out", tmp_path / "out")
    (error, *_) = one_error(done.stderr)
    assert error.startswith("CAL-005")
    assert "start.tool_from_marker: translation_mm has length 0.205: give millimetres, not metres" in error


@pytest.mark.parametrize("arguments", [(), ("--sim", "--from", "x"), ("--sim", "--write", "x.toml")])
def test_options_that_do_not_go_together_are_refused(arguments: tuple[str, ...]) -> None:
    assert in_this_process(app, "calibrate", "tracker-frame", *arguments).returncode == 2


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_page_about_the_reference_frame_works(commands: Commands, tmp_path: Path) -> None:
    lines = commands_of("docs/how-to/calibrate-tracker-frame.md")
    assert lines
    run_all(lines, commands, tmp_path)
    (folder,) = (tmp_path / "calibrations").iterdir()
    assert (folder / "report.html").is_file()
