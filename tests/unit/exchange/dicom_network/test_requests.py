"""Requests to DCMTK's archive, what is refused before anything is sent, and peers that are not there."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from coded_errors import raises
from dicom_stand import HOST, dcmtk_archive, free_port, needs_dcmtk, receiving, run_dcmtk, write_patient
from pydicom.dataset import Dataset
from user_commands import in_this_process

from procedures.cli.dicom import app
from procedures.exchange.dicom_network import errors
from procedures.exchange.dicom_network.peers import Peer, TlsFiles, require_title
from procedures.exchange.dicom_network.requests import Requester
from procedures.exchange.dicom_network.sending import describe_owner, read_objects
from ronna_hw.errors import EXIT_USAGE

ANNA = int.from_bytes(b"anna", "big")
STUDY, SERIES = f"2.25.{ANNA}.1", f"2.25.{ANNA}.2"


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, int]]:
    """DCMTK's archive with one series, and the port at which it knows us."""
    folder, ours = tmp_path_factory.mktemp("archive"), free_port()
    with dcmtk_archive(folder, ours) as port:
        sent = write_patient(folder / "sent", "anna")
        done = run_dcmtk("dcmsend", "-aec", "ARCHIVE", HOST, port, "--scan-directories", sent)
        assert done.returncode == 0, done.stderr
        yield f"ARCHIVE@{HOST}:{port}", ours


@needs_dcmtk
def test_an_archive_is_asked_for_a_patients_series_and_sends_one_into_the_inbox(
    archive: tuple[str, int], tmp_path: Path
) -> None:
    peer, ours = archive
    assert in_this_process(app, "echo", peer).returncode == 0
    found = in_this_process(app, "find", peer, "--patient", "anna", "--json")
    (row,) = json.loads(found.stdout)["series"]
    assert (row["study"], row["series"], row["study_date"]) == (STUDY, SERIES, "20260102")
    got = in_this_process(app, "fetch", peer, STUDY, SERIES, "--out", tmp_path / "inbox", "--port", ours)
    assert got.returncode == 0, got.stderr
    line = json.loads(got.stdout)
    assert (line["state"], line["instances"], line["complete"]) == ("complete", 4, True)
    listed = in_this_process(app, "inbox", tmp_path / "inbox", "--json")
    assert json.loads(listed.stdout)["series"] == [line]


@needs_dcmtk
def test_a_series_that_the_archive_does_not_have_is_named(archive: tuple[str, int], tmp_path: Path) -> None:
    peer, ours = archive
    got = in_this_process(app, "fetch", peer, STUDY, "2.25.9", "--out", tmp_path / "inbox", "--port", ours)
    assert got.returncode == 1
    assert "DCM-008" in got.stderr
    assert in_this_process(app, "find", peer, "--patient", "nobody").returncode == 1


@needs_dcmtk
def test_objects_of_one_patient_are_sent_and_it_is_said_whose_they_are(
    archive: tuple[str, int], tmp_path: Path
) -> None:
    peer, _ = archive
    sent = in_this_process(app, "send", peer, write_patient(tmp_path / "sent", "clara"))
    assert sent.returncode == 0, sent.stderr
    assert "4 objects of Secret^Name, identifier clara" in sent.stderr
    assert Requester("RONNA", Peer.parse(peer)).find("STUDY", {"PatientID": "clara", "StudyInstanceUID": ""})


def test_a_peer_that_keeps_not_all_objects_is_an_error(tmp_path: Path) -> None:
    def be_another_class(data: Dataset, place: int) -> None:
        if place == 0:
            data.SOPClassUID = data.file_meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.7"

    folder = write_patient(tmp_path / "sent", "anna", edit=be_another_class)
    with receiving(tmp_path / "inbox") as stand:
        sent = in_this_process(app, "send", f"RONNA@{HOST}:{stand.port}", folder)
    assert (sent.returncode, "DCM-007" in sent.stderr) == (5, True)
    assert "0000.dcm: the peer does not accept this kind of object" in sent.stderr
    assert len(stand.files()) == 3


@pytest.mark.parametrize("missing", ["PatientID", "StudyInstanceUID"])
def test_an_object_without_a_patient_or_a_study_is_not_sent(tmp_path: Path, missing: str) -> None:
    folder = write_patient(tmp_path / "sent", "anna", edit=lambda data, _: setattr(data, missing, ""))
    with raises(errors.NOT_SENDABLE, match="DCM-014"):
        read_objects([folder])


def test_objects_of_two_patients_are_not_sent_together(tmp_path: Path) -> None:
    folders = [write_patient(tmp_path / name, name) for name in ("anna", "boris")]
    with raises(errors.NOT_SENDABLE, match="2 patients"):
        read_objects(folders)
    assert "identifier anna" in describe_owner(read_objects(folders[:1])[1])


def test_a_peer_that_is_not_there_and_one_that_refuses_are_told_apart(tmp_path: Path) -> None:
    with raises(errors.NO_PEER, match="DCM-005"):
        Requester("RONNA", Peer("PACS", HOST, free_port())).echo()
    with receiving(tmp_path / "inbox", callers=["SCANNER"]) as stand:
        with raises(errors.ASSOCIATION_REFUSED, match="DCM-006"):
            Requester("OTHER", Peer("RONNA", HOST, stand.port)).echo()
        with raises(errors.ASSOCIATION_REFUSED, match="accepts none"):
            Requester("SCANNER", Peer("RONNA", HOST, stand.port)).find("STUDY", {"PatientID": "anna"})


def test_tls_with_the_certificate_of_the_authority_is_answered(tmp_path: Path, make_tls: object) -> None:
    assert callable(make_tls)
    tls: TlsFiles = make_tls()
    with receiving(tmp_path / "inbox", tls=tls) as stand:
        Requester("SCANNER", Peer("RONNA", HOST, stand.port), tls).echo()
        with raises(errors.NO_PEER, match="DCM-005"):
            Requester("SCANNER", Peer("RONNA", HOST, stand.port)).echo()


@pytest.mark.parametrize(
    "text", ["PACS", "PACS@host", "PACS@host:0", "@host:104", "A" * 17 + "@h:1", "PACS@h:x"]
)
def test_an_address_that_is_none_is_refused_with_its_form(text: str) -> None:
    with raises(errors.BAD_ADDRESS, match="DCM-002"):
        Peer.parse(text)
    assert require_title(" PACS ") == "PACS"


@pytest.mark.parametrize("asked", [[], ["--patient", "*"]])
def test_nobody_lists_all_patients_of_an_archive(asked: list[str]) -> None:
    refused = in_this_process(app, "find", "PACS@127.0.0.1:104", *asked)
    assert refused.returncode == 2


def test_files_for_tls_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    with raises(errors.TLS_UNUSABLE, match="DCM-004"):
        TlsFiles(tmp_path / "a", tmp_path / "b", tmp_path / "c").client_context()
    alone = in_this_process(app, "echo", "PACS@127.0.0.1:104", "--tls-cert", tmp_path / "a")
    assert (alone.returncode, "DCM-004" in alone.stderr) == (2, True)


def test_without_the_extra_a_command_says_which_line_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    refused = in_this_process(app, "echo", "PACS@127.0.0.1:104")
    assert refused.returncode == 2
    assert refused.stderr.startswith("DCM-001")
    assert "pip install 'ronna-hw[dicom]'" in refused.stderr


@pytest.mark.parametrize("typed", ["", "   \n"])
def test_an_empty_identifier_from_standard_input_lists_nobody(
    monkeypatch: pytest.MonkeyPatch, typed: str
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(typed))
    refused = in_this_process(app, "find", "PACS@127.0.0.1:1", "--patient", "-")
    assert refused.returncode == EXIT_USAGE
    assert "PatientID is empty" in refused.stderr
