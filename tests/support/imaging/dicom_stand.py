"""DICOM peers for the tests: our receiver in this process, series to send, and foreign peers."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
import pytest
from painted_ct import write_series
from pydicom.dataset import Dataset
from pydicom.uid import UID
from pynetdicom import AE
from pynetdicom.association import Association
from pynetdicom.dimse_primitives import C_STORE
from pynetdicom.sop_class import CTImageStorage  # type: ignore[attr-defined]
from waiting import eventually

from procedures.exchange.dicom_network import arrivals as arrivals_module
from procedures.exchange.dicom_network.arrivals import Arrivals
from procedures.exchange.dicom_network.inbox import InboxEntry
from procedures.exchange.dicom_network.peers import TlsFiles
from procedures.exchange.dicom_network.receiver import Listening, Receiver

# pynetdicom installs programs of the same names as DCMTK's into our environment
FOREIGN_PATH = os.pathsep.join(
    folder for folder in os.get_exec_path() if Path(folder).resolve() != Path(sys.prefix, "bin").resolve()
)
DCMTK = {
    name: shutil.which(name, path=FOREIGN_PATH) for name in ("dcmsend", "echoscu", "storescu", "dcmqrscp")
}
needs_dcmtk = pytest.mark.skipif(None in DCMTK.values(), reason="proof not made: install Debian's dcmtk")
ORTHANC = shutil.which("Orthanc")
needs_orthanc = pytest.mark.skipif(ORTHANC is None, reason="proof not made: install Debian's orthanc")
HOST = "127.0.0.1"


@dataclass
class Stand:
    """A receiver with its inbox, and everything that it said."""

    inbox: Path
    port: int = 0
    told: list[str] = field(default_factory=list)
    entries: list[InboxEntry] = field(default_factory=list)

    def files(self) -> list[Path]:
        """Slices of the inbox."""
        return sorted(self.inbox.glob("*/ct/*.dcm"))


@contextmanager
def receiving(
    inbox: Path, *, callers: Sequence[str] = (), tls: TlsFiles | None = None, **options: Any
) -> Iterator[Stand]:
    """Receive into an inbox for the block, at a free port of loopback."""
    stand = Stand(inbox)
    listening = Listening("RONNA", HOST, 0, callers, tls)
    with Receiver(listening, Arrivals(inbox, stand.entries.append, **options), stand.told.append) as one:
        stand.port = one.port
        yield stand


def write_patient(folder: Path, patient: str, slices: int = 4, edit: Any = None) -> Path:
    """Write a CT series of a patient; each patient has a study and a series of his own."""
    number = int.from_bytes(patient.encode(), "big")

    def name(data: Dataset, place: int) -> None:
        data.PatientID, data.StudyID, data.StudyDate, data.AccessionNumber = patient, "1", "20260102", "A1"
        data.StudyInstanceUID, data.SeriesInstanceUID = f"2.25.{number}.1", f"2.25.{number}.2"
        data.SOPInstanceUID = data.file_meta.MediaStorageSOPInstanceUID = UID(f"2.25.{number}.3.{place + 1}")
        if edit is not None:
            edit(data, place)

    return write_series(folder, np.full((slices, 16, 16), -900, np.int16), edit=name)


def store_all(arrivals: Arrivals, folder: Path) -> None:
    """Store the files of a folder as a receiver would."""
    for path in sorted(folder.glob("*.dcm")):
        data = pydicom.dcmread(path, stop_before_pixels=True)
        arrivals.store("SCANNER", path.read_bytes(), str(data.SOPClassUID), str(data.SOPInstanceUID))


def settle_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Judge a series at its first quiet moment, without the two seconds."""
    monkeypatch.setattr(arrivals_module, "QUIET_S", 0.0)


@contextmanager
def associated(port: int, *, syntaxes: Sequence[str] = (), title: str = "SCANNER") -> Iterator[Association]:
    """Open an association for CT slices by pynetdicom."""
    entity = AE(title)
    entity.add_requested_context(CTImageStorage, list(syntaxes) or None)
    association = entity.associate(HOST, port, ae_title="RONNA")
    try:
        yield association
    finally:
        if association.is_established:
            association.abort()


def store_bytes(association: Association, instance_uid: str, content: bytes) -> int:
    """Send an encoded data set under any name, as a forger could; return the status of the answer."""
    request = C_STORE()
    request.MessageID, request.Priority = 1, 2
    request.AffectedSOPClassUID, request.AffectedSOPInstanceUID = CTImageStorage, instance_uid
    request.DataSet = BytesIO(content)
    (context,) = association.accepted_contexts
    association._reactor_checkpoint.clear()
    eventually(lambda: association._is_paused)
    assert context.context_id is not None, "it was accepted"
    association.dimse.send_msg(request, context.context_id)
    _, answer = association.dimse.get_msg(block=True)
    association._reactor_checkpoint.set()
    return -1 if answer is None or answer.Status is None else int(answer.Status)


def run_dcmtk(program: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a program of DCMTK to its end."""
    line = [str(DCMTK[program]), *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, timeout=60, check=False)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


@contextmanager
def dcmtk_archive(folder: Path, ours: int) -> Iterator[int]:
    """Run DCMTK's archive, which knows us as RONNA at a port; return its own port."""
    port, store = free_port(), folder / "archive"
    store.mkdir(parents=True)
    config = folder / "dcmqrscp.cfg"
    config.write_text(
        f"NetworkTCPPort = {port}\nMaxPDUSize = 16384\nMaxAssociations = 16\n"
        f"HostTable BEGIN\nronna = (RONNA, {HOST}, {ours})\nHostTable END\n"
        "VendorTable BEGIN\nVendorTable END\n"
        f"AETable BEGIN\nARCHIVE {store} RW (9, 1024mb) ANY\nAETable END\n"
    )
    with _running([str(DCMTK["dcmqrscp"]), "--config", str(config)], lambda: _listens(port)):
        yield port


@dataclass(frozen=True)
class Orthanc:
    """A running Orthanc: its DICOM port and its REST address."""

    port: int
    address: str

    def get(self, path: str) -> Any:
        with urllib.request.urlopen(f"{self.address}{path}", timeout=30) as answer:
            return json.load(answer)


@contextmanager
def orthanc(folder: Path, ours: int) -> Iterator[Orthanc]:
    """Run Orthanc in a folder; it knows us as RONNA at a port."""
    assert ORTHANC is not None, "the test is skipped without it"
    port, http = free_port(), free_port()
    folder.mkdir(parents=True)
    config = {
        "StorageDirectory": str(folder / "store"),
        "IndexDirectory": str(folder / "store"),
        "DicomAet": "ORTHANC",
        "DicomPort": port,
        "HttpPort": http,
        "HttpBindAddresses": [HOST],
        "RemoteAccessAllowed": False,
        "AuthenticationEnabled": False,
        "DicomModalities": {"ronna": ["RONNA", HOST, ours]},
        "Plugins": [],
    }
    (folder / "orthanc.json").write_text(json.dumps(config))
    with _running([ORTHANC, str(folder / "orthanc.json")], lambda: _listens(port) and _listens(http)):
        yield Orthanc(port, f"http://{HOST}:{http}")


@contextmanager
def _running(line: Sequence[str], ready: Callable[[], bool]) -> Iterator[None]:
    process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        eventually(ready)
        yield
    finally:
        process.terminate()
        process.wait(30)


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((HOST, port)) == 0
