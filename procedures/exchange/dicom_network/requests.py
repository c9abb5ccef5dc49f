"""Requests to a DICOM peer: echo, find, move to ourselves, store."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

from pydicom.dataset import Dataset
from pynetdicom import AE, build_context, evt
from pynetdicom.sop_class import (  # type: ignore[attr-defined]  # made at import
    StudyRootQueryRetrieveInformationModelFind,
    StudyRootQueryRetrieveInformationModelMove,
    Verification,
)

from procedures.exchange.dicom_network.errors import (
    ASSOCIATION_REFUSED,
    BAD_ADDRESS,
    NO_PEER,
    REQUEST_FAILED,
)
from procedures.exchange.dicom_network.listener import GuardedSocket, begin_message
from procedures.exchange.dicom_network.object_checks import require_uid
from ronna_hw.text import printable

if TYPE_CHECKING:
    import ssl

    from pynetdicom.association import Association
    from pynetdicom.presentation import PresentationContext
    from pynetdicom.transport import AddressInformation, AssociationSocket

    from procedures.exchange.dicom_network.peers import Peer, TlsFiles

CONNECT_S = 10.0
ANSWER_S = 60.0  # an archive may fetch from tape
MOST_ANSWERS = 1000  # to one question
MOST_SLICES = 20_000  # of one series, where the peer lists them instead of counting
SUCCESS, PENDING, CANCELLED = 0x0000, (0xFF00, 0xFF01), 0xFE00
WARNINGS = (0xB000, 0xB006, 0xB007)  # of a stored object: kept, with elements changed or dropped
FIND, MOVE = StudyRootQueryRetrieveInformationModelFind, StudyRootQueryRetrieveInformationModelMove
NOT_CALLED_BACK = (
    "Most often the peer cannot call back: check that it knows this AE title with this computer's address "
    "and port, and that no firewall lies between. Its own log has the reason."
)
UNCOUNTED = "the peer does not say how many"


class _Entity(AE):
    """Application entity whose associations have sockets with limits."""

    def _create_socket(
        self, assoc: Association, address: AddressInformation, tls_args: tuple[ssl.SSLContext, str] | None
    ) -> AssociationSocket:
        line = GuardedSocket(assoc, address=address)
        if tls_args is not None:
            line.tls_args = tls_args
        return line


@dataclass(frozen=True)
class Requester:
    """This computer as a caller of one peer."""

    title: str
    peer: Peer
    tls: TlsFiles | None = None

    @contextlib.contextmanager
    def associate(self, contexts: Sequence[PresentationContext]) -> Iterator[Association]:
        """Open an association for the block. Raises DCM-005, DCM-006."""
        entity = _Entity(self.title)
        entity.connection_timeout = entity.acse_timeout = CONNECT_S
        entity.network_timeout = entity.dimse_timeout = ANSWER_S
        options = {} if self.tls is None else {"tls_args": (self.tls.client_context(), self.peer.host)}
        try:
            association = entity.associate(
                self.peer.host,
                self.peer.port,
                contexts=list(contexts),
                ae_title=self.peer.title,
                evt_handlers=[(evt.EVT_DIMSE_RECV, begin_message)],
                **options,  # type: ignore[arg-type]
            )
        except OSError as problem:  # the name of the host
            raise BAD_ADDRESS(f"{self.peer.host} cannot be resolved", got=str(problem)) from problem
        if not association.is_established:
            if association.is_rejected:
                reason = getattr(association.acceptor.primitive, "reason_str", "") or "no reason"
                raise ASSOCIATION_REFUSED(f"{self.peer} refuses {self.title}", got=printable(reason))
            if association.acceptor.primitive is not None:  # answered, and accepts nothing of it
                raise ASSOCIATION_REFUSED(f"{self.peer} accepts none of what {self.title} asks for")
            raise NO_PEER(f"no answer from {self.peer}", limit=f"{CONNECT_S:g} s")
        try:
            yield association
        finally:
            if association.is_established:
                association.release()

    def echo(self) -> None:
        """Ask the peer whether it is there. Raises DCM-005 to DCM-007."""
        with self.associate([build_context(Verification)]) as association:
            self._require(association.send_c_echo(), "echo")

    def find(self, level: str, keys: Mapping[str, str], most: int = MOST_ANSWERS) -> list[Dataset]:
        """Return the peer's matches at a level of study, series and image. Raises DCM-005 to DCM-007."""
        wanted = Dataset()
        wanted.QueryRetrieveLevel = level
        for keyword, value in keys.items():
            setattr(wanted, keyword, value)
        with self.associate([build_context(FIND)]) as association:
            found: list[Dataset] = []
            for status, answer in islice(association.send_c_find(wanted, FIND), most + 1):
                if _status(status) in PENDING:
                    if answer is not None:
                        found.append(answer)
                    continue
                self._require(status, f"find {level.lower()}")
            if len(found) > most:
                words = f"{self.peer} has too many matches"
                raise REQUEST_FAILED(words, limit=f"{most}", action="Ask for less, such as one study.")
            return found

    def count_slices(self, study_uid: str, series_uid: str) -> int:
        """Return how many images the peer has of a series, 0 if it knows none. Raises DCM-005 to DCM-007."""
        keys = {"StudyInstanceUID": study_uid, "SeriesInstanceUID": series_uid}
        for answer in self.find("SERIES", {**keys, "NumberOfSeriesRelatedInstances": ""}):
            with contextlib.suppress(TypeError, ValueError, OverflowError):  # optional, and may be empty
                return int(answer.get("NumberOfSeriesRelatedInstances"))
        return len(self.find("IMAGE", {**keys, "SOPInstanceUID": ""}, most=MOST_SLICES))

    def retrieve(self, study_uid: str, series_uid: str) -> int:
        """Have the peer send a series to our AE title; return how many it says it sent.

        Raises DCM-005 to DCM-007.
        """
        wanted = Dataset()
        wanted.QueryRetrieveLevel = "SERIES"
        wanted.StudyInstanceUID = require_uid(study_uid, "Study Instance UID")
        wanted.SeriesInstanceUID = require_uid(series_uid, "Series Instance UID")
        sent = 0
        with self.associate([build_context(MOVE)]) as association:
            for status, _ in association.send_c_move(wanted, self.title, MOVE):
                sent = int(status.get("NumberOfCompletedSuboperations", None) or sent)
                if _status(status) not in PENDING:
                    self._require(status, "move", (SUCCESS, 0xB000), NOT_CALLED_BACK)  # 0xB000: not all
        return sent

    def store(self, objects: Sequence[Dataset]) -> list[str]:
        """Store objects at the peer; return for each an empty text, or why it is not there.

        Raises DCM-005, DCM-006.
        """
        kinds = {(str(one.SOPClassUID), str(one.file_meta.TransferSyntaxUID)) for one in objects}
        outcome = []
        with self.associate([build_context(kind, syntax) for kind, syntax in sorted(kinds)]) as association:
            for one in objects:
                try:
                    status = _status(association.send_c_store(one))
                except ValueError:  # no such context was accepted
                    outcome.append("the peer does not accept this kind of object")
                except RuntimeError:  # the association has ended
                    outcome.append("the peer has ended the association")
                else:
                    kept = status in (SUCCESS, *WARNINGS)
                    outcome.append("" if kept else f"the peer refused it with status {_format(status)}")
        return outcome

    def _require(
        self,
        status: Dataset,
        request: str,
        allowed: Sequence[int] = (SUCCESS,),
        action: str | None = None,
    ) -> None:
        if (number := _status(status)) not in allowed:
            comment = printable(str(status.get("ErrorComment", "")))
            got = f"{_format(number)} {comment}".rstrip()
            raise REQUEST_FAILED(
                f"{self.peer} did not carry out: {request}", expected="0x0000", got=got, action=action
            )


def _status(status: Dataset) -> int:
    """Return the status of an answer, -1 if none has come."""
    return int(status.Status) if "Status" in status else -1


def _format(status: int) -> str:
    return "no answer" if status < 0 else f"0x{status:04X}"
