"""Hazard 35: the patient's name appears in no output, whatever goes wrong with the series."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from painted_ct import write_series
from spoiled_slices import every, setting

SECRETS = ("Seeded^Patient", "SEEDED-ID", "19610203", "Seeded Hospital", "Seeded^Physician")
SLICES = 12


@pytest.fixture
def series(tmp_path: Path) -> Path:
    """An empty scan whose headers are full of patient data."""
    words = ("PatientName", "PatientID", "PatientBirthDate", "InstitutionName", "ReferringPhysicianName")
    named = every(setting(**dict(zip(words, SECRETS, strict=True))))
    return write_series(tmp_path / "series", np.full((SLICES, 32, 32), -1000, dtype=np.int16), edit=named)


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


@pytest.mark.hazard(35)
@pytest.mark.parametrize("spoil", [_sound, _without_a_slice, _truncated, _with_an_unreadable_name])
def test_no_message_traceback_or_log_contains_patient_data(series: Path, spoil: object) -> None:
    assert callable(spoil)
    spoil(series)
    command = (
        "import sys; from pathlib import Path; from procedures.cli.ct import main; "
        "from ronna_hw.log_output import keep_log\n"
        "with keep_log(Path(sys.argv.pop())): main()"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", command, "localize", str(series), "--verbose", str(series.parent)],
        capture_output=True,
        text=True,
        timeout=150,
        env={**os.environ, "RONNA_LOG": "debug"},
    )
    assert done.returncode != 0
    assert "CT-0" in done.stderr
    log = (series.parent / "log.jsonl").read_text()
    assert "failed" in log
    for secret in (*SECRETS, "Seeded^Patien"):
        assert secret not in done.stdout + done.stderr + log
    assert str(series) not in log
