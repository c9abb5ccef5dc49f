"""A series of the inbox becomes the CT of a case, after a person has read back whose it is."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

from procedures.exchange.dicom_network.errors import NOT_READY_TO_TAKE, READ_BACK_DIFFERS
from procedures.exchange.dicom_network.inbox import InboxEntry, SeriesState, find_series, mark_taken
from procedures.imaging.dicom.slice_headers import CT_FOLDER, ScanIdentity, read_scan_identity
from procedures.imaging.series import read_series
from procedures.imaging.volume import Volume
from procedures.operator.question import ReadBack
from ronna_hw.command_line.errors import PATH_PROBLEM
from ronna_hw.host.files import remove_folder, sync_folder

Show = Callable[[InboxEntry, ScanIdentity], None]
Read = Callable[[ReadBack], str]


def take_series(inbox: Path, name: str, case: Path, show: Show, read: Read) -> Volume:
    """Copy a series into the `ct` folder of a case and return its volume.

    `show` presents it to a person, `read` has a value read back. Raises DCM-011 to DCM-013, CLI-005 if the
    case has a CT, and the errors of `read_series`.
    """
    entry = find_series(inbox, name)
    if entry.state is SeriesState.ARRIVING:
        raise NOT_READY_TO_TAKE(f"series {entry.name} is arriving", got=entry.record.reason or None)
    ct = case / CT_FOLDER
    if ct.exists():
        raise PATH_PROBLEM(f"{ct} exists", expected="a case without a CT", action="Name a new case folder.")
    scan = read_scan_identity(entry.slices)
    if not scan.patient.identifier:
        raise NOT_READY_TO_TAKE(
            f"series {entry.name} has no patient identifier",
            action="Have it sent with the patient's identifier: without one nobody can say whose it is.",
        )
    show(entry, scan)
    for value in _list_read_backs(entry, scan):
        if not value.fits(read(value)):
            raise READ_BACK_DIFFERS(f"series {entry.name}: what was typed {value.wrong}")
    case.mkdir(parents=True, exist_ok=True)
    copy = case / f".{CT_FOLDER}-{os.getpid()}"
    try:
        shutil.copytree(entry.slices, copy)
        volume = read_series(copy)
        now = find_series(inbox, entry.name)
        if now.record != entry.record or volume.geometry.shape[0] != entry.record.instances:
            raise NOT_READY_TO_TAKE(f"slices of series {entry.name} arrived while it was taken")
        copy.rename(ct)
        sync_folder(case)
    finally:
        remove_folder(copy)
    mark_taken(entry)
    return volume


def _list_read_backs(entry: InboxEntry, scan: ScanIdentity) -> list[ReadBack]:
    """List the values to be read back: the patient, and the slices if no source has said how many."""
    values = [
        ReadBack(
            "the patient's identifier, as in the patient's papers",
            scan.patient.identifier,
            wrong="is not the identifier in this CT (PatientID)",
            exact=True,
        )
    ]
    if entry.record.complete is not True:
        count = str(entry.record.instances)
        what = "the number of slices of this series, as the scanner or the archive states it"
        values.append(
            ReadBack(
                what,
                count,
                wrong="is not the number of slices that have arrived: some are missing, or there are others",
            )
        )
    return values
