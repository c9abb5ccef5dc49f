"""The receiver of CT slices before senders that are right, wrong, silent, hostile or too many."""

from __future__ import annotations

import socket
import struct
import subprocess
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

import pydicom
import pytest
from coded_errors import raises
from dicom_stand import (
    DCMTK,
    HOST,
    associated,
    needs_dcmtk,
    receiving,
    run_dcmtk,
    settle_at_once,
    store_bytes,
    write_patient,
)
from pydicom.dataset import Dataset
from pydicom.filewriter import write_dataset
from pydicom.uid import JPEG2000Lossless
from user_commands import in_this_process
from waiting import eventually

from procedures.cli.dicom import app
from procedures.exchange.dicom_network import errors, listener, receiver
from procedures.exchange.dicom_network.peers import TlsFiles
from procedures.exchange.dicom_network.receiver import Listening

SILENT = 200


@needs_dcmtk
def test_a_series_of_dcmtk_arrives_and_is_reported_once_it_is_quiet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settle_at_once(monkeypatch)
    folder = write_patient(tmp_path / "sent", "anna")
    with receiving(tmp_path / "inbox", callers=["SCANNER"]) as stand:
        assert run_dcmtk("echoscu", "-aet", "SCANNER", "-aec", "RONNA", HOST, stand.port).returncode == 0
        sent = run_dcmtk(
            "dcmsend", "-aet", "SCANNER", "-aec", "RONNA", HOST, stand.port, "--scan-directories", folder
        )
        assert sent.returncode == 0, sent.stderr
        eventually(lambda: bool(stand.entries) and stand.entries[-1].record.instances == 4)
    (last,) = stand.entries[-1:]
    assert (last.record.complete, last.record.caller) == ("unknown", "SCANNER")
    assert last.record.extent is not None
    arrived = {str(pydicom.dcmread(path).SOPInstanceUID) for path in stand.files()}
    assert arrived == {str(pydicom.dcmread(path).SOPInstanceUID) for path in folder.iterdir()}


@needs_dcmtk
@pytest.mark.parametrize(
    ("caller", "called", "reason"), [("SCANNER", "OTHER", "called"), ("X", "RONNA", "--allow")]
)
def test_a_wrong_title_is_refused_and_told(tmp_path: Path, caller: str, called: str, reason: str) -> None:
    with receiving(tmp_path / "inbox", callers=["SCANNER"]) as stand:
        assert run_dcmtk("echoscu", "-aet", caller, "-aec", called, HOST, stand.port).returncode != 0
        eventually(lambda: bool(stand.told))
    assert reason in stand.told[0]


def test_off_loopback_the_senders_must_be_named() -> None:
    with raises(errors.CALLERS_UNNAMED, match="DCM-003"):
        Listening("RONNA", "192.168.7.1", 0)


@needs_dcmtk
def test_two_patients_arrive_whole_among_silent_connections_and_aborted_associations(tmp_path: Path) -> None:
    folders = [write_patient(tmp_path / name, name, slices=12) for name in ("anna", "boris")]
    with ExitStack() as held, receiving(tmp_path / "inbox") as stand:
        silent = [held.enter_context(socket.create_connection((HOST, stand.port))) for _ in range(SILENT)]
        with associated(stand.port) as aborted:
            assert aborted.is_established
        sender = (str(DCMTK["dcmsend"]), "-aec", "RONNA")
        senders = [
            subprocess.Popen(
                [*sender, HOST, str(stand.port), "--scan-directories", str(folder)],
                stderr=subprocess.DEVNULL,
            )
            for folder in folders
        ]
        assert [one.wait(60) for one in senders] == [0, 0]
        assert len(silent) == SILENT
        patients = [
            {str(pydicom.dcmread(path).PatientID) for path in folder.glob("ct/*.dcm")}
            for folder in stand.inbox.iterdir()
            if folder.name != ".incoming"
        ]
        assert sorted(map(sorted, patients)) == [["anna"], ["boris"]]
        assert len(stand.files()) == 24


@pytest.mark.filterwarnings("ignore:Invalid value for VR UI")
def test_a_path_instead_of_an_identifier_is_refused_with_its_status(tmp_path: Path) -> None:
    data = pydicom.dcmread(next(write_patient(tmp_path / "sent", "anna").iterdir()))
    data.SOPInstanceUID = "../../../evil"
    with receiving(tmp_path / "inbox") as stand, associated(stand.port) as association:
        assert store_bytes(association, "../../../evil", _encode(data)) == receiver.DOES_NOT_FIT
    assert "DCM-009" in stand.told[0]
    assert {one.name for one in tmp_path.iterdir()} == {"sent", "inbox"}
    assert [one for one in stand.inbox.rglob("*") if one.is_file() and one.name != "lock"] == []


def test_a_truncated_object_is_refused_and_the_association_goes_on(tmp_path: Path) -> None:
    data = pydicom.dcmread(next(write_patient(tmp_path / "sent", "anna").iterdir()))
    uid, whole = str(data.SOPInstanceUID), _encode(data)
    with receiving(tmp_path / "inbox") as stand, associated(stand.port) as association:
        assert store_bytes(association, uid, whole[:-100]) == receiver.DOES_NOT_FIT
        assert stand.files() == []
        assert store_bytes(association, uid, whole) == receiver.DONE
        assert len(stand.files()) == 1


def test_a_full_disk_is_answered_as_out_of_resources_and_ends_with_the_shortage(tmp_path: Path) -> None:
    data = pydicom.dcmread(next(write_patient(tmp_path / "sent", "anna").iterdir()))
    free = [0]
    with (
        receiving(tmp_path / "inbox", free_bytes=lambda _folder: free[0]) as stand,
        associated(stand.port) as association,
    ):
        uid, content = str(data.SOPInstanceUID), _encode(data)
        assert store_bytes(association, uid, content) == receiver.OUT_OF_RESOURCES
        free[0] = 10**12
        assert store_bytes(association, uid, content) == receiver.DONE
    assert "DCM-010" in stand.told[0]


def test_a_compressed_slice_is_accepted_only_where_a_decoder_is_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(receiver, "can_decode", lambda syntax: syntax != JPEG2000Lossless)
    with (
        receiving(tmp_path / "inbox") as stand,
        associated(stand.port, syntaxes=[JPEG2000Lossless]) as association,
    ):
        assert association.accepted_contexts == []


@pytest.mark.parametrize("message", ["one of four gigabytes", "without an end"])
def test_an_endless_message_ends_its_own_association_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, message: str
) -> None:
    monkeypatch.setattr(listener, "LARGEST_SLICE_BYTES", 300_000)
    with receiving(tmp_path / "inbox") as stand, associated(stand.port) as good:
        with associated(stand.port) as endless:
            line = endless.dul.socket.socket
            part = struct.pack(">BBLLBB", 4, 0, 16_006, 16_002, 1, 0) + bytes(16_000)
            if message != "without an end":
                part = struct.pack(">BBL", 4, 0, 0xFFFFFFF0)
            with suppress(OSError):
                while _still_open(line):
                    line.sendall(part)
            assert not _still_open(line)
            line.close()  # the library's client leaves it open
        assert good.is_established
        data = pydicom.dcmread(next(write_patient(tmp_path / "sent", "anna").iterdir()))
        assert store_bytes(good, str(data.SOPInstanceUID), _encode(data)) == receiver.DONE


@needs_dcmtk
def test_over_tls_only_a_peer_with_a_certificate_is_served_and_a_silent_one_holds_up_nobody(
    tmp_path: Path, make_tls: Callable[[], TlsFiles]
) -> None:
    tls = make_tls()
    slice_file = next(write_patient(tmp_path / "sent", "anna").iterdir())
    line = ("storescu", "-aec", "RONNA", HOST)
    with (
        receiving(tmp_path / "inbox", tls=tls) as stand,
        socket.create_connection((HOST, stand.port)),
    ):
        assert run_dcmtk(*line, stand.port, slice_file).returncode != 0
        files = ("+tls", tls.key, tls.certificate, "+cf", tls.authority)
        sent = run_dcmtk(*line, stand.port, *files, slice_file)
        assert sent.returncode == 0, sent.stderr
        assert len(stand.files()) == 1


def _encode(data: Dataset) -> bytes:
    """Encode in implicit VR, which pynetdicom proposes first and we do not choose."""
    from pydicom.filebase import DicomBytesIO

    buffer = DicomBytesIO()
    buffer.is_little_endian, buffer.is_implicit_VR = True, False
    del data.file_meta
    write_dataset(buffer, data)
    return buffer.getvalue()


def _still_open(line: socket.socket) -> bool:
    """Whether the peer has neither closed nor reset a connection on which it says nothing."""
    try:
        return bool(line.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT))
    except BlockingIOError:
        return True
    except OSError:
        return False


def test_an_address_that_is_in_use_is_named(tmp_path: Path) -> None:
    with receiving(tmp_path / "inbox") as stand:
        used = ("--port", str(stand.port), "--out", tmp_path / "other")
        refused = in_this_process(app, "receive", *used)
    assert f"CLI-006: tcp://{HOST}:{stand.port}" in refused.stderr
