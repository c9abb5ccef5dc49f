"""Objects as they arrive: checked, written whole, and judged as a series when it has become quiet.

DICOM has no end of a series. Only its source can say how many slices there are.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import filecmp
import itertools
import os
import shutil
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from procedures.exchange.dicom_network.errors import NO_ROOM, OBJECT_REFUSED
from procedures.exchange.dicom_network.inbox import (
    Extent,
    InboxEntry,
    ReceivedSeries,
    SeriesState,
    list_series,
    name_series,
    name_slice,
    write_record,
)
from procedures.exchange.dicom_network.object_checks import ReceivedObject, check_object, read_patient
from procedures.imaging.dicom.slice_headers import CT_FOLDER, read_headers
from procedures.imaging.dicom.slice_stack import stack_slices
from ronna_hw.command_line.errors import PATH_PROBLEM
from ronna_hw.errors import RonnaError
from ronna_hw.host.files import sync_folder

INCOMING = ".incoming"  # objects until they are checked
QUIET_S = 2.0  # between two slices of one sender pass milliseconds, on a busy line a second
LEAST_FREE_BYTES = 500_000_000  # a series of 1000 slices; a case in the same folder needs less
FULL_DISK = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})

CountAtSource = Callable[[str, str], int]  # of a study's series
FreeBytes = Callable[[Path], int]


@dataclass
class _Arrival:
    """A series in this process: whose it is, and when its last object came."""

    folder: Path
    record: ReceivedSeries
    patient: tuple[str, ...] | None  # None: no slice of it is there yet
    last_s: float  # monotonic
    is_settled: bool = False


class Arrivals:
    """Objects of an inbox, of which one process at a time is the receiver.

    `count_at_source` is asked for the number of slices, None where no source is known. `report` is called
    with each series that has become quiet.
    """

    def __init__(
        self,
        inbox: Path,
        report: Callable[[InboxEntry], None],
        *,
        count_at_source: CountAtSource | None = None,
        least_free_bytes: int = LEAST_FREE_BYTES,
        free_bytes: FreeBytes = lambda folder: shutil.disk_usage(folder).free,
    ) -> None:
        self._inbox = inbox
        self._report = report
        self._count_at_source = count_at_source
        self._least_free_bytes = least_free_bytes
        self._free_bytes = free_bytes
        self._guard = threading.Lock()
        self._numbers = itertools.count()
        self._arrivals: dict[str, _Arrival] = {}  # by the name of the series
        self._incoming = inbox / INCOMING
        self._incoming.mkdir(parents=True, exist_ok=True)
        self._lock = os.open(self._incoming / "lock", os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as problem:
            os.close(self._lock)
            words = f"another receiver writes into {inbox}"
            raise PATH_PROBLEM(words, action="Give another folder, or end that receiver.") from problem
        for rest in self._incoming.glob("*.part"):  # of a receiver that was killed
            rest.unlink()
        for entry in list_series(inbox):
            if entry.state is SeriesState.ARRIVING:
                self._arrivals[entry.name] = self._continue(entry)

    def close(self) -> None:
        """Let another process receive into this inbox."""
        os.close(self._lock)

    def store(self, caller: str, content: bytes, class_uid: str, instance_uid: str) -> None:
        """Check an object and put it into the folder of its series. Raises DCM-009, DCM-010, OSError."""
        free = self._free_bytes(self._inbox)
        if free - len(content) < self._least_free_bytes:
            limit = f"at least {self._least_free_bytes // 1_000_000} MB free"
            raise NO_ROOM(f"{self._inbox} is nearly full", limit=limit, got=f"{free // 1_000_000} MB")
        part = self._incoming / f"{next(self._numbers)}.part"
        try:
            with part.open("xb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            found = check_object(part, class_uid, instance_uid)
            arrival = self._find_arrival(found, caller)
            target = arrival.folder / CT_FOLDER / name_slice(found.instance_uid)
            if target.exists() and not filecmp.cmp(part, target, shallow=False):
                raise OBJECT_REFUSED("another object with the identifier of this one has arrived before")
            part.replace(target)  # on disk by name when it is judged
            self._find_arrival(found, caller)  # its time is the end, not the beginning
        except OSError as problem:
            if problem.errno in FULL_DISK:
                raise NO_ROOM(f"{self._inbox} is full", got=os.strerror(problem.errno)) from problem
            raise
        finally:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)

    def settle(self) -> None:
        """Judge and report each series of which nothing has come for two seconds."""
        with self._guard:
            now_s = time.monotonic()
            quiet = [
                (one, one.last_s)
                for one in self._arrivals.values()
                if not one.is_settled and now_s - one.last_s >= QUIET_S
            ]
        for arrival, last_s in quiet:
            judged = self._judge(arrival)
            with self._guard:
                if arrival.last_s != last_s:  # it goes on
                    continue
                arrival.record, arrival.is_settled = judged, True
                write_record(arrival.folder, judged)
            self._report(InboxEntry(arrival.folder, judged, judged.state))

    def _find_arrival(self, found: ReceivedObject, caller: str) -> _Arrival:
        """Return the series of an object, begun if it is the first. Raises DCM-009 if it does not fit."""
        name = name_series(found.series_uid)
        now = datetime.now(UTC)
        with self._guard:
            arrival = self._arrivals.get(name)
            if arrival is None:
                arrival = self._begin(name, found, caller, now)
            record = arrival.record
            if (record.series_instance_uid, record.study_instance_uid) != (found.series_uid, found.study_uid):
                raise OBJECT_REFUSED("the object names another study than the slices of its series")
            if arrival.patient is None:
                arrival.patient = found.patient
            if arrival.patient != found.patient:  # messages must not identify patients
                raise OBJECT_REFUSED("the object names another patient than the slices of its series")
            arrival.last_s = time.monotonic()
            update = {"state": SeriesState.ARRIVING, "caller": caller, "last_arrival": now}
            arrival.record = record.model_copy(update=update)
            if arrival.is_settled:
                arrival.is_settled = False
                write_record(arrival.folder, arrival.record)
            return arrival

    def _begin(self, name: str, found: ReceivedObject, caller: str, now: datetime) -> _Arrival:
        folder = self._inbox / name
        known = next((one for one in list_series(self._inbox) if one.name == name), None)
        if known is not None:
            arrival = self._continue(known)
        else:
            record = ReceivedSeries(
                series_instance_uid=found.series_uid,
                study_instance_uid=found.study_uid,
                caller=caller,
                first_arrival=now,
                last_arrival=now,
            )
            (folder / CT_FOLDER).mkdir(parents=True, exist_ok=True)
            write_record(folder, record)
            sync_folder(self._inbox)
            arrival = _Arrival(folder, record, found.patient, time.monotonic())
        self._arrivals[name] = arrival
        return arrival

    def _continue(self, entry: InboxEntry) -> _Arrival:
        """Take up a series from the disk, with the patient of a slice that is there."""
        path = next(entry.slices.glob("*.dcm"), None)
        patient = None if path is None else read_patient(path)
        settled = entry.state is not SeriesState.ARRIVING
        return _Arrival(entry.folder, entry.record, patient, time.monotonic() - QUIET_S, settled)

    def _judge(self, arrival: _Arrival) -> ReceivedSeries:
        folder = arrival.folder / CT_FOLDER
        sync_folder(folder)
        instances = sum(1 for _ in folder.glob("*.dcm"))
        extent, problem = None, ""
        try:
            _, geometry = stack_slices(read_headers(folder))
            low, high = (end.round(2).tolist() for end in geometry.ends_mm)
            extent = Extent(low_mm=low, high_mm=high, spacing_mm=round(float(geometry.spacing_mm[0]), 4))
        except RonnaError as refused:
            problem = f"{refused.code}: {refused.summary}"
        expected, reason = self._ask(arrival.record)
        if expected is None or instances > expected:
            state = SeriesState.UNKNOWN
            reason = reason or f"{instances} slices have arrived, the source has {expected}"
        else:
            state = SeriesState.COMPLETE if instances == expected else SeriesState.ARRIVING
            reason = (
                "" if instances == expected else f"{expected - instances} of {expected} slices are missing"
            )
        found = {"state": state, "instances": instances, "expected": expected, "reason": reason}
        return arrival.record.model_copy(update={**found, "extent": extent, "problem": problem})

    def _ask(self, record: ReceivedSeries) -> tuple[int | None, str]:
        """Ask the source for the number of slices; return it, or why there is none."""
        if self._count_at_source is None:
            return None, "no source is known that could be asked how many slices there are"
        try:
            count = self._count_at_source(record.study_instance_uid, record.series_instance_uid)
        except RonnaError as problem:
            return (
                None,
                f"the source does not say how many slices there are: {problem.code}, {problem.summary}",
            )
        return (count, "") if count else (None, "the source does not know this series")
