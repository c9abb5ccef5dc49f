"""Receiver of CT slices (Storage SCP), which answers echoes too and accepts nothing else."""

from __future__ import annotations

import contextlib
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

from pynetdicom import AE, evt
from pynetdicom.sop_class import Verification  # type: ignore[attr-defined]  # made at import

from procedures.exchange.dicom_network.errors import CALLERS_UNNAMED, NO_ROOM, OBJECT_REFUSED
from procedures.exchange.dicom_network.listener import FIRST_BYTE_S, NETWORK_S, PatientServer, begin_message
from procedures.exchange.dicom_network.object_checks import CT_IMAGE_STORAGE
from procedures.imaging.dicom.frame_decoder import JPEG, JPEG_2000, JPEG_LS, RLE, can_decode
from ronna_hw.errors import RonnaError, summary_of
from ronna_hw.logs import logger
from ronna_hw.text import printable

if TYPE_CHECKING:
    from pynetdicom.events import Event

    from procedures.exchange.dicom_network.arrivals import Arrivals
    from procedures.exchange.dicom_network.peers import TlsFiles

LOOPBACK = ("127.0.0.1", "::1", "localhost")
UNCOMPRESSED = ("1.2.840.10008.1.2.1", "1.2.840.10008.1.2")  # explicit and implicit VR little endian
MOST_ASSOCIATIONS = 10
SETTLE_S = 0.25
MOST_SHOWN = 100  # kinds of refusal that are told one by one; a hostile sender can invent any number

DONE, OUT_OF_RESOURCES, DOES_NOT_FIT, CANNOT_PROCESS = 0x0000, 0xA700, 0xA900, 0xC000  # PS3.4 B.2.3
_STATUS = {OBJECT_REFUSED.code: DOES_NOT_FIT, NO_ROOM.code: OUT_OF_RESOURCES}


@dataclass(frozen=True)
class Listening:
    """Address, AE title and permitted callers of a receiver."""

    title: str
    address: str
    port: int  # 0: any free one
    callers: Sequence[str] = ()  # nobody named: anybody, on loopback only
    tls: TlsFiles | None = None

    def __post_init__(self) -> None:
        """Raise DCM-003 if other computers could send and no sender is named."""
        if self.address not in LOOPBACK and not self.callers:
            raise CALLERS_UNNAMED(f"a receiver at {self.address} would take objects from anybody")


class Receiver:
    """Server that puts objects into an inbox until it is closed. `tell` shows a sentence to a person."""

    def __init__(self, listening: Listening, arrivals: Arrivals, tell: Callable[[str], None]) -> None:
        self._arrivals = arrivals
        self._tell = tell
        self._told = Counter[str]()
        self._guard = threading.Lock()
        self._ending = threading.Event()
        self._entity = entity = AE(listening.title)
        entity.require_called_aet = True
        entity.require_calling_aet = list(listening.callers)
        entity.maximum_associations = MOST_ASSOCIATIONS
        entity.acse_timeout = FIRST_BYTE_S
        entity.network_timeout = entity.dimse_timeout = NETWORK_S
        entity.add_supported_context(Verification, list(UNCOMPRESSED))
        decodable = [one for one in (JPEG_LS, RLE, *JPEG_2000, *JPEG) if can_decode(one)]
        entity.add_supported_context(CT_IMAGE_STORAGE, [*UNCOMPRESSED, *dict.fromkeys(decodable)])
        handlers: list[Any] = [
            (evt.EVT_C_STORE, self._store),
            (evt.EVT_DIMSE_RECV, begin_message),
            (evt.EVT_REJECTED, self._note_rejection),
        ]
        tls = None if listening.tls is None else listening.tls.server_context()
        try:
            self._server = PatientServer(entity, (listening.address, listening.port), handlers, tls)
        except OSError as problem:
            problem.filename = f"tcp://{listening.address}:{listening.port}"  # for the message
            raise
        self._serving = threading.Thread(target=self._server.serve_forever, args=(SETTLE_S,), daemon=True)
        self._settling = threading.Thread(target=self._settle, name="inbox", daemon=True)
        self._serving.start()
        self._settling.start()

    @property
    def port(self) -> int:
        """Port at which it listens."""
        return int(self._server.server_address[1])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Abort what is open, and end."""
        self._ending.set()
        with contextlib.suppress(ValueError):  # it is not in the library's list of servers
            self._server.shutdown()
        for association in self._server.active_associations:
            association.abort()
        self._settling.join()
        self._serving.join()
        self._arrivals.close()

    def _settle(self) -> None:
        while not self._ending.wait(SETTLE_S):
            try:
                self._arrivals.settle()
            except OSError as problem:
                self._tell_once(f"the inbox cannot be written: {problem.strerror}")
            except Exception as problem:  # foreign answers can break it in any way; the next series counts
                self._tell_once(f"a series could not be judged: {type(problem).__name__} {problem}")

    def _store(self, event: Event) -> int:
        caller = printable(str(event.assoc.requestor.ae_title))
        try:
            request: Any = event.request
            class_uid, instance_uid = str(request.AffectedSOPClassUID), str(request.AffectedSOPInstanceUID)
            self._arrivals.store(caller, event.encoded_dataset(), class_uid, instance_uid)
        except RonnaError as refused:
            self._tell_once(f"refused an object of {caller}: {refused}")
            return _STATUS.get(refused.code, CANNOT_PROCESS)
        except Exception as problem:  # foreign bytes, or the disk: the next object may pass
            logger(part="dicom").warning("object not stored", problem=type(problem).__name__)
            self._tell_once(f"an object of {caller} was not stored: {summary_of(problem)}")
            return CANNOT_PROCESS
        return DONE

    def _note_rejection(self, event: Event) -> None:
        request = event.assoc.requestor.primitive
        caller, called = (
            printable(str(getattr(request, side, ""))) for side in ("calling_ae_title", "called_ae_title")
        )
        if called != self._entity.ae_title:
            reason = f"it called {called!r}, this is {self._entity.ae_title!r}: correct it at the sender"
        elif self._entity.require_calling_aet and caller not in self._entity.require_calling_aet:
            reason = "its AE title is not among those of --allow"
        else:
            reason = f"{MOST_ASSOCIATIONS} associations are open; it may try again"
        self._tell_once(f"refused an association of {caller!r}: {reason}")

    def _tell_once(self, sentence: str) -> None:
        """Tell each kind of refusal at its first, second, fourth, eighth time."""
        with self._guard:
            if sentence not in self._told and len(self._told) >= MOST_SHOWN:
                return
            self._told[sentence] += 1
            count = self._told[sentence]
        if count & (count - 1) == 0:
            self._tell(sentence if count == 1 else f"{sentence} (for the {count}th time)")
