"""`ronna-dicom`: CT series from the hospital's network into cases, and objects of a run back to it."""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from ronna_hw.command_line import terminal
from ronna_hw.text import format_count, printable

if TYPE_CHECKING:
    from pydicom.dataset import Dataset

    from procedures.exchange.dicom_network.inbox import InboxEntry
    from procedures.exchange.dicom_network.peers import TlsFiles
    from procedures.exchange.dicom_network.requests import Requester
    from procedures.imaging.dicom.slice_headers import ScanIdentity
    from procedures.operator.question import ReadBack

DEFAULT_TITLE = "RONNA"
DEFAULT_PORT = 11112  # registered for DICOM; 104 needs root
MOST_REFUSALS_SHOWN = 10
app = terminal.command_group(
    "ronna-dicom",
    "CT series from a PACS or scanner into cases, and a run's objects back.",
    example="ronna-dicom receive --out inbox --source PACS@192.168.7.2:104 --allow PACS",
)

PeerArgument = Annotated[str, Argument(metavar="PEER", help="The peer, as AETITLE@HOST:PORT.")]
InboxArgument = Annotated[Path, Argument(metavar="DIR", help="The inbox: --out of receive or fetch.")]
InboxOption = Annotated[Path, Option("--out", metavar="DIR", help="The inbox; made if it is missing.")]
TitleOption = Annotated[str, Option("--aet", metavar="AET", help="AE title of this computer.")]
ListenOption = Annotated[str, Option("--listen", metavar="ADDRESS", help="Own address to listen at.")]
PortOption = Annotated[int, Option("--port", min=0, max=65535, help="Own port; 0: any free one.")]
CertificateOption = Annotated[
    Path | None, Option("--tls-cert", metavar="FILE", help="TLS: certificate of this computer (PEM).")
]
KeyOption = Annotated[Path | None, Option("--tls-key", metavar="FILE", help="TLS: its private key (PEM).")]
AuthorityOption = Annotated[
    Path | None, Option("--tls-ca", metavar="FILE", help="TLS: the CA that signs the peers' certificates.")
]


@app.command()
def receive(
    out: InboxOption,
    aet: TitleOption = DEFAULT_TITLE,
    listen: ListenOption = "127.0.0.1",
    port: PortOption = DEFAULT_PORT,
    allow: Annotated[
        list[str] | None,
        Option("--allow", metavar="AET", help="AE title of a sender; repeatable; required off loopback."),
    ] = None,
    source: Annotated[
        str | None,
        Option("--source", metavar="PEER", help="Archive asked how many slices a series has: AET@HOST:PORT."),
    ] = None,
    tls_cert: CertificateOption = None,
    tls_key: KeyOption = None,
    tls_ca: AuthorityOption = None,
) -> None:
    """Receive CT slices into an inbox until interrupted. Nothing starts by arriving: see inbox and take.

    Prints READY {json}, then a line of JSON for each series that has become quiet. Exit codes: 2 usage, 3 a
    sender must be named, 130 interrupted.
    """
    from procedures.exchange.dicom_network.peers import Peer, require_network, require_title

    require_network()
    from procedures.exchange.dicom_network.arrivals import Arrivals
    from procedures.exchange.dicom_network.receiver import Listening, Receiver
    from procedures.exchange.dicom_network.requests import Requester

    tls = _tls_files(tls_cert, tls_key, tls_ca)
    listening = Listening(require_title(aet), listen, port, [require_title(one) for one in allow or ()], tls)
    asked = None if source is None else Requester(listening.title, Peer.parse(source), tls).count_slices
    with Receiver(listening, Arrivals(out, _print_line, count_at_source=asked), terminal.tell) as receiver:
        endpoint = f"tcp://{listen}:{receiver.port}"
        sys.stdout.write(f"READY {json.dumps({'device': 'dicom', 'aet': aet, 'endpoint': endpoint})}\n")
        sys.stdout.flush()
        threading.Event().wait()  # for a signal


@app.command()
def inbox(directory: InboxArgument, as_json: terminal.JsonOption = False) -> None:
    """List the series of an inbox: state, slices, extent. Names no patient.

    Exit codes: 0 done, 2 usage.
    """
    from procedures.exchange.dicom_network.inbox import list_series
    from ronna_hw.command_line.errors import PATH_PROBLEM

    if not directory.is_dir():
        raise PATH_PROBLEM(f"there is no inbox {directory}", expected="the folder given as --out of receive")
    entries = list_series(directory)
    if as_json:
        terminal.print_json({"series": [one.as_dict() for one in entries]})
        return
    rows = []
    for one in entries:
        record = one.record
        of = "?" if record.expected is None else record.expected
        remark = record.problem or record.reason
        last = f"{record.last_arrival:%Y-%m-%d %H:%M}"
        rows.append([one.name, one.state, f"{record.instances}/{of}", _extent(one), last, remark])
    headings = ["name", "state", "slices", "extent", "last, UTC", "remark"]
    terminal.print_table(f"{format_count(len(rows), 'series', 'series')} in {directory}", headings, rows)


@app.command()
def take(
    directory: InboxArgument,
    name: Annotated[str, Argument(help="Name of the series, its beginning, or its Series Instance UID.")],
    case: Annotated[Path, Option("--case", metavar="DIR", help="The case folder that gets it as ct.")],
) -> None:
    """Make a series of the inbox the CT of a case, once a person has read back whose it is.

    Asks for the patient's identifier and, where no source said how many slices there are, for their number;
    without a terminal each is a line of standard input. Exit codes: 0 taken, 1 the series is unusable, 2
    usage, 3 refused, 130 interrupted.
    """
    from procedures.exchange.dicom_network.taking import take_series
    from procedures.imaging.dicom.slice_headers import CT_FOLDER

    volume = take_series(directory, name, case, _show_scan, _read_back)
    for sentence in volume.warnings:
        terminal.tell(f"warning: {sentence}")
    ct = case / CT_FOLDER
    terminal.say(f"{ct}: {volume.geometry.shape[0]} slices; then: ronna-plan new {ct} --out {case}/plan.toml")


@app.command()
def echo(
    peer: PeerArgument,
    aet: TitleOption = DEFAULT_TITLE,
    tls_cert: CertificateOption = None,
    tls_key: KeyOption = None,
    tls_ca: AuthorityOption = None,
) -> None:
    """Ask a peer whether it is there and accepts this AE title.

    Exit codes: 0 it answers, 2 usage, 4 no answer or refused, 5 it answers with an error.
    """
    _requester(peer, aet, tls_cert, tls_key, tls_ca).echo()
    terminal.say(f"{peer} answers")


@app.command()
def find(
    peer: PeerArgument,
    patient: Annotated[
        str | None,
        Option("--patient", metavar="ID", help="The patient's identifier; - reads it from standard input."),
    ] = None,
    study: Annotated[str | None, Option("--study", metavar="UID", help="Study Instance UID.")] = None,
    accession: Annotated[
        str | None, Option("--accession", metavar="NUMBER", help="Accession number.")
    ] = None,
    aet: TitleOption = DEFAULT_TITLE,
    tls_cert: CertificateOption = None,
    tls_key: KeyOption = None,
    tls_ca: AuthorityOption = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """List the CT series that a peer has of a patient or study. Names no patient.

    Exit codes: 0 found, 1 nothing found, 2 usage, 4 no answer or refused, 5 the peer answers with an error.
    """
    from ronna_hw.command_line.errors import UsageMistake

    if patient == "-":
        patient = sys.stdin.readline()
    asked = {"PatientID": patient, "StudyInstanceUID": study, "AccessionNumber": accession}
    keys = {keyword: value.strip() for keyword, value in asked.items() if value is not None}
    if empty := [keyword for keyword, value in keys.items() if not value]:
        raise UsageMistake(
            f"{empty[0]} is empty", expected="one identifier", action="An empty one would list all patients."
        )
    if not keys:
        raise UsageMistake("nothing is asked for", expected="--patient, --study or --accession")
    if any(letter in value for value in keys.values() for letter in "*?\\"):
        raise UsageMistake("a pattern would list other patients", expected="one identifier")
    requester = _requester(peer, aet, tls_cert, tls_key, tls_ca)
    wanted_too = {"PatientID": "", "StudyInstanceUID": "", "StudyDate": "", "StudyDescription": ""}
    rows = []
    for found in requester.find("STUDY", {**wanted_too, **keys}):
        study_uid = str(found.get("StudyInstanceUID", ""))
        wanted = {"StudyInstanceUID": study_uid, "SeriesInstanceUID": "", "Modality": "CT"}
        more = {"SeriesDescription": "", "SeriesNumber": "", "NumberOfSeriesRelatedInstances": ""}
        for one in requester.find("SERIES", {**wanted, **more}):
            rows.append({"study_date": _text(found, "StudyDate"), "study": study_uid, **_series_row(one)})
    if as_json:
        terminal.print_json({"series": rows})
    else:
        headings = ["date", "slices", "description", "study UID", "series UID"]
        columns = ("study_date", "instances", "description", "study", "series")
        lines = [[str(row[column]) for column in columns] for row in rows]
        terminal.print_table(
            f"{format_count(len(rows), 'CT series', 'CT series')} at {peer}", headings, lines
        )
    if not rows:
        sys.exit(1)


@app.command()
def fetch(
    peer: PeerArgument,
    study: Annotated[str, Argument(metavar="STUDY_UID", help="Study Instance UID, from find.")],
    series: Annotated[str, Argument(metavar="SERIES_UID", help="Series Instance UID, from find.")],
    out: InboxOption,
    aet: TitleOption = DEFAULT_TITLE,
    listen: ListenOption = "127.0.0.1",
    port: PortOption = DEFAULT_PORT,
    tls_cert: CertificateOption = None,
    tls_key: KeyOption = None,
    tls_ca: AuthorityOption = None,
) -> None:
    """Have a peer send a CT series to this computer, and put it into an inbox.

    The peer must know this AE title with address and port. Prints a line of JSON. Exit codes: 0 complete, 1
    not all slices arrived, 2 usage, 4 no answer or refused, 5 the peer answers with an error.
    """
    requester = _requester(peer, aet, tls_cert, tls_key, tls_ca)
    from procedures.exchange.dicom_network.fetching import fetch_series

    _print_line(fetch_series(requester, study, series, out, listen, port, terminal.tell))


@app.command()
def send(
    peer: PeerArgument,
    paths: Annotated[
        list[Path], Argument(metavar="PATH...", help="DICOM files, or folders with them, such as an export.")
    ],
    aet: TitleOption = DEFAULT_TITLE,
    tls_cert: CertificateOption = None,
    tls_key: KeyOption = None,
    tls_ca: AuthorityOption = None,
) -> None:
    """Send DICOM objects of one patient to a peer, saying whose they are.

    Objects without a patient or a study are refused before anything is sent. Exit codes: 0 all are stored, 2
    usage, 3 refused here, 4 no answer or refused, 5 the peer did not store all.
    """
    requester = _requester(peer, aet, tls_cert, tls_key, tls_ca)
    from procedures.exchange.dicom_network.errors import REQUEST_FAILED
    from procedures.exchange.dicom_network.sending import describe_owner, read_objects

    files, objects = read_objects(paths)
    terminal.tell(f"sending {format_count(len(objects), 'object')} of {describe_owner(objects)} to {peer}")
    outcome = requester.store(objects)
    failed = [f"{file.name}: {reason}" for file, reason in zip(files, outcome, strict=True) if reason]
    for line in failed[:MOST_REFUSALS_SHOWN]:
        terminal.tell(line)
    if failed:
        stored = len(objects) - len(failed)
        raise REQUEST_FAILED("not all objects are stored", expected=f"{len(objects)}", got=f"{stored}")
    terminal.say(f"{format_count(len(objects), 'object')} stored at {peer}")


def _requester(
    peer: str, aet: str, certificate: Path | None, key: Path | None, authority: Path | None
) -> Requester:
    from procedures.exchange.dicom_network.peers import Peer, require_network, require_title

    require_network()
    from procedures.exchange.dicom_network.requests import Requester

    return Requester(require_title(aet), Peer.parse(peer), _tls_files(certificate, key, authority))


def _tls_files(certificate: Path | None, key: Path | None, authority: Path | None) -> TlsFiles | None:
    if certificate is None and key is None and authority is None:
        return None
    from procedures.exchange.dicom_network.errors import TLS_UNUSABLE
    from procedures.exchange.dicom_network.peers import TlsFiles

    if certificate is None or key is None or authority is None:
        raise TLS_UNUSABLE("one of the three files for TLS is not given")
    return TlsFiles(certificate, key, authority)


def _print_line(entry: InboxEntry) -> None:
    sys.stdout.write(json.dumps(entry.as_dict()) + "\n")
    sys.stdout.flush()


def _show_scan(entry: InboxEntry, scan: ScanIdentity) -> None:
    name = ", ".join(part for part in scan.patient.name.split("^") if part) or "no name"
    born = scan.patient.birth_date or "unknown"
    terminal.tell(printable(f"series {entry.name}: {name}, born {born}"))
    terminal.tell(printable(f"scan of {scan.date or 'unknown date'}: {scan.study or 'no description'}"))
    terminal.tell(
        f"extent {_extent(entry)}, sent by {entry.record.caller}; {entry.record.reason or 'complete'}"
    )


def _read_back(value: ReadBack) -> str:
    sys.stderr.write(f"{value.what}:{' ' if sys.stdin.isatty() else chr(10)}")
    sys.stderr.flush()
    return sys.stdin.readline().rstrip("\n")


def _extent(entry: InboxEntry) -> str:
    """Say what the slices cover from foot to head, which shows whether an end is missing."""
    if (extent := entry.record.extent) is None:
        return "?"
    low, high = extent.low_mm[2], extent.high_mm[2]
    return f"S {low:.1f} to {high:.1f} mm in steps of {extent.spacing_mm:g} mm"


def _series_row(found: Dataset) -> dict[str, Any]:
    return {
        "series": _text(found, "SeriesInstanceUID"),
        "number": _text(found, "SeriesNumber"),
        "description": _text(found, "SeriesDescription"),
        "instances": _text(found, "NumberOfSeriesRelatedInstances"),
    }


def _text(found: Dataset, keyword: str) -> str:
    value = found.get(keyword)
    return "" if value is None else printable(str(value))


def main() -> None:
    """Run the command."""
    terminal.run(app)
