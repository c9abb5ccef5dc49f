"""`ronna-dicom receive` as a process, before DCMTK and Orthanc."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pydicom
import pytest
from dicom_stand import HOST, free_port, needs_dcmtk, needs_orthanc, orthanc, run_dcmtk, write_patient
from pydicom.uid import generate_uid
from user_commands import Commands, in_this_process
from waiting import HANG_LIMIT_S

from procedures.cli.dicom import app
from ronna_hw.errors import EXIT_INTERRUPTED


@needs_dcmtk
def test_the_receiver_says_when_it_is_ready_reports_a_series_and_ends_when_told(
    commands: Commands, tmp_path: Path
) -> None:
    inbox, sent = tmp_path / "inbox", write_patient(tmp_path / "sent", "anna")
    options = ("--out", str(inbox), "--port", "0", "--allow", "SCANNER")
    process = commands.start("ronna-dicom", "receive", *options)
    assert process.stdout is not None
    ready = json.loads(process.stdout.readline().removeprefix("READY "))
    port = ready["endpoint"].rpartition(":")[2]
    line = ("-aet", "SCANNER", "-aec", "RONNA", HOST, port)
    assert run_dcmtk("dcmsend", *line, "--scan-directories", sent).returncode == 0
    series = json.loads(process.stdout.readline())
    assert (series["instances"], series["complete"], series["state"]) == (4, "unknown", "unknown")
    process.send_signal(signal.SIGTERM)
    assert process.communicate(timeout=HANG_LIMIT_S)[1].strip() == "interrupted"
    assert process.returncode == EXIT_INTERRUPTED


@needs_orthanc
@pytest.mark.slow
def test_orthanc_stores_finds_and_sends_a_series_and_files_an_answer_in_its_study(tmp_path: Path) -> None:
    ours, sent = free_port(), write_patient(tmp_path / "sent", "anna", slices=8)
    with orthanc(tmp_path / "orthanc", ours) as archive:
        peer = f"ORTHANC@{HOST}:{archive.port}"
        assert in_this_process(app, "echo", peer).returncode == 0
        assert in_this_process(app, "send", peer, sent).returncode == 0
        found = in_this_process(app, "find", peer, "--accession", "A1", "--json")
        (row,) = json.loads(found.stdout)["series"]
        assert row["instances"] == "8"
        line = ("fetch", peer, row["study"], row["series"], "--out", tmp_path / "inbox", "--port", ours)
        got = in_this_process(app, *line)
        assert (got.returncode, json.loads(got.stdout)["complete"]) == (0, True), got.stderr
        answer = pydicom.dcmread(next(sent.iterdir()))
        answer.SeriesInstanceUID, answer.SOPInstanceUID = generate_uid(), generate_uid()
        answer.file_meta.MediaStorageSOPInstanceUID = answer.SOPInstanceUID
        answer.save_as(tmp_path / "answer.dcm", enforce_file_format=True)
        assert in_this_process(app, "send", peer, tmp_path / "answer.dcm").returncode == 0
        counts = [len(archive.get(f"/{level}")) for level in ("patients", "studies", "series", "instances")]
        assert counts == [1, 1, 2, 9]
