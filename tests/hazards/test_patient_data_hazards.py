"""Hazard 35: the patient's name appears in no output, whatever goes wrong with the series."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from painted_ct import write_series
from spoiled_slices import every, setting

SECRETS = ("Seeded^Patient", "SEEDED-ID", "19610203", "Seeded Hospital", "Seeded^Physician")
SLICES = 12


def _written(folder: Path) -> Path:
    """An empty scan whose headers are full of patient data."""
    words = ("PatientName", "PatientID", "PatientBirthDate", "InstitutionName", "ReferringPhysicianName")
    named = every(setting(**dict(zip(words, SECRETS, strict=True))))
    return write_series(folder, np.full((SLICES, 32, 32), -1000, dtype=np.int16), edit=named)


def _sound(_series: Path) -> None:
    """Leave the series as it is: no marker will be found in it."""


def _without_a_slice(series: Path) -> None:
    (series / "0005.dcm").unlink()


def _truncated(series: Path) -> None:
    os.truncate(series / "0004.dcm", 700)


def _with_an_unreadable_name(series: Path) -> None:
    """A value that pydicom warns about, quoting it."""
    path = series / "0006.dcm"
    path.write_bytes(path.read_bytes().replace(b"Seeded^Patient", b"Seeded^Patien\xff"))


SPOILERS = (_sound, _without_a_slice, _truncated, _with_an_unreadable_name)
LOCALIZE_EACH = """
import sys
from pathlib import Path

from procedures.cli.ct import app
from ronna_hw.command_line.terminal import exit_code_of
from ronna_hw.log_output import keep_log

for folder in sys.argv[1:]:
    with keep_log(Path(folder)):
        code = exit_code_of(app, ["localize", f"{folder}/series", "--verbose"])
    for stream in (sys.stdout, sys.stderr):
        print(f"ended {code}", file=stream, flush=True)
"""


@pytest.mark.hazard(35)
def test_no_message_traceback_or_log_contains_patient_data(tmp_path: Path) -> None:
    folders = [tmp_path / str(number) for number in range(len(SPOILERS))]
    for folder, spoil in zip(folders, SPOILERS, strict=True):
        spoil(_written(folder / "series"))
    done = subprocess.run(
        [sys.executable, "-P", "-c", LOCALIZE_EACH, *map(str, folders)],
        capture_output=True,
        text=True,
        timeout=150,
        env={**os.environ, "RONNA_LOG": "debug"},
    )
    assert done.returncode == 0, done.stderr
    *said, _ = re.split(r"ended \d+\n", done.stderr)
    assert len(said) == len(folders)
    assert "ended 0" not in done.stderr
    for folder, errors in zip(folders, said, strict=True):
        assert "CT-0" in errors
        assert "Traceback" in errors
        log = (folder / "log.jsonl").read_text()
        assert "failed" in log
        for secret in (*SECRETS, "Seeded^Patien"):
            assert secret not in done.stdout + errors + log
        assert str(folder / "series") not in log
