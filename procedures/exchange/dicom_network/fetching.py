"""Fetching of one series: the peer is asked to send it, and the call returns once all of it has arrived."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from procedures.exchange.dicom_network.arrivals import Arrivals
from procedures.exchange.dicom_network.errors import NOT_ALL_ARRIVED
from procedures.exchange.dicom_network.inbox import InboxEntry
from procedures.exchange.dicom_network.receiver import Listening, Receiver
from procedures.exchange.dicom_network.requests import Requester

ARRIVAL_S = 30.0  # host time after the peer's last word: two seconds of quiet, and a look at the slices


def fetch_series(
    requester: Requester,
    study_uid: str,
    series_uid: str,
    inbox: Path,
    listen: str,
    port: int,
    say: Callable[[str], None],
) -> InboxEntry:
    """Have a peer send a series to this computer, at this address and port; return it in the inbox.

    Raises DCM-005 to DCM-007, and DCM-008 if it has not arrived whole.
    """
    arrived = threading.Event()
    found: list[InboxEntry] = []

    def report(entry: InboxEntry) -> None:
        if entry.record.series_instance_uid == series_uid:
            found.append(entry)
            if entry.record.instances >= expected:  # a slow archive pauses for longer than two seconds
                arrived.set()

    expected = requester.count_slices(study_uid, series_uid)
    listening = Listening(requester.title, listen, port, [requester.peer.title], requester.tls)
    arrivals = Arrivals(inbox, report, count_at_source=requester.count_slices)
    with Receiver(listening, arrivals, say) as receiver:
        if expected:
            requester.retrieve(study_uid, series_uid)  # what it says of its count is optional
            arrived.wait(ARRIVAL_S)
        place = f"{listen}:{receiver.port}"
    here = found[-1].record.instances if found else 0
    if here != expected or not expected:
        how = None if here else f"Check both UIDs, and that the peer knows {requester.title} at {place}."
        raise NOT_ALL_ARRIVED(
            f"the series has not arrived whole from {requester.peer}",
            expected=f"{expected or 'some'} slices",
            got=f"{here}",
            action=how,
        )
    return found[-1]
