"""`ronna-dicom` and a patient's series, for peers of the DICOM network."""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

from dicom_stand import free_port, write_patient
from pydicom.dataset import Dataset
from user_commands import in_this_process

from procedures.cli.dicom import app

FOLDER = Path(mkdtemp())
PORT = free_port()  # at which a peer knows us as RONNA
PATIENT, SLICES = "anna", 4


def ours(*words: object) -> dict[str, Any]:
    """Run `ronna-dicom`; return what it says as JSON, if anything."""
    done = in_this_process(app, *words)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout) if done.stdout.startswith("{") else {}


def series(**attributes: str) -> Path:
    """Write a patient's CT, with these values in each slice."""

    def edit(data: Dataset, _place: int) -> None:
        for keyword, value in attributes.items():
            setattr(data, keyword, value)

    return write_patient(FOLDER / "sent", PATIENT, SLICES, edit)


def find(peer: str) -> list[dict[str, str]]:
    """Return the patient's series at a peer."""
    found: list[dict[str, str]] = ours("find", peer, "--patient", PATIENT, "--json")["series"]
    return found


def fetch(peer: str) -> dict[str, Any]:
    """Have a peer send us the patient's series."""
    (row,) = find(peer)
    line = ("fetch", peer, row["study"], row["series"], "--out", FOLDER / "inbox", "--port", PORT)
    return ours(*line)
