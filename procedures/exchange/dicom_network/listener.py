"""Server for associations in which silent, slow and endless senders cost neither threads nor memory.

pynetdicom gives each TCP connection two polling threads and a place among the associations, makes the TLS
handshake while nobody else is accepted, and reads a message of any length. Here a connection waits in a
selector until its first byte, and what follows has limits of time and size.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
import time
from typing import TYPE_CHECKING, Any

from pynetdicom.transport import AssociationSocket, RequestHandler, ThreadedAssociationServer

from procedures.imaging.dicom.attributes import LARGEST_SLICE_BYTES
from ronna_hw.logs import logger

if TYPE_CHECKING:
    import ssl

    from pynetdicom import AE
    from pynetdicom.association import Association
    from pynetdicom.events import Event

FIRST_BYTE_S = 3.0  # as long as an association may take to be asked for, in each of its two parts
NETWORK_S = 20.0  # for the rest of a message that has begun in an association
MOST_WAITING = 512  # silent connections; the oldest goes
MOST_PDU_BYTES = 1 << 20  # senders keep to what we announce, a sixteenth
WAKE_S = 0.1


class GuardedSocket(AssociationSocket):
    """Socket of one association, with limits for time and size of a message."""

    message_bytes = 0  # since the last whole message

    def recv(self, nr_bytes: int) -> bytearray:
        """Read so many bytes, fewer at the end of the connection. Raises OSError beyond the limits."""
        self.message_bytes += nr_bytes
        if nr_bytes > MOST_PDU_BYTES or self.message_bytes > LARGEST_SLICE_BYTES:
            raise OSError("the message is longer than any slice")
        assert self.socket is not None, "it is connected"
        content = bytearray(nr_bytes)
        rest = memoryview(content)
        limit_s = NETWORK_S if self.assoc.is_established else FIRST_BYTE_S
        deadline_s = time.monotonic() + limit_s
        while rest:
            self.socket.settimeout(max(0.01, deadline_s - time.monotonic()))
            if not (count := self.socket.recv_into(rest)):
                break
            rest = rest[count:]
        missing = len(rest)
        rest.release()
        self.socket.settimeout(NETWORK_S)  # for the answer
        return content[: nr_bytes - missing]

    def _shutdown_socket(self) -> None:
        """Close the socket, also of a peer that has gone: the library then leaves it open."""
        if self.socket is not None:
            with contextlib.suppress(OSError):
                self.socket.shutdown(socket.SHUT_RDWR)
            with contextlib.suppress(OSError):
                self.socket.close()


def begin_message(event: Event) -> None:
    """Let the next message have its own limit of size."""
    line = event.assoc.dul.socket
    if isinstance(line, GuardedSocket):
        line.message_bytes = 0


class _GuardedHandler(RequestHandler):
    """Makes an association of a connection, with a socket that has limits."""

    def handle(self) -> None:
        """Serve an association to its end, and close its connection, which the library can leave open."""
        association = self._create_association()
        association.start()
        association.join()
        association.dul.join(NETWORK_S)
        with contextlib.suppress(OSError):
            self.request.close()

    def _create_association(self) -> Association:
        association = super()._create_association()
        association.dul.event_queue.get_nowait()  # the socket that is replaced said that it is connected
        association.dul.socket = GuardedSocket(association, client_socket=self.request)
        return association


class PatientServer(ThreadedAssociationServer):
    """Association server that lets connections wait for their first byte before they get a thread."""

    request_queue_size = 128  # connections that the system keeps until they are accepted
    daemon_threads = True

    def __init__(
        self,
        entity: AE,
        address: tuple[str, int],
        handlers: list[Any],
        tls: ssl.SSLContext | None,
    ) -> None:
        self._tls = tls  # ours: the library's handshake would hold up all others
        self._waiting = selectors.DefaultSelector()
        self._ends_s: dict[socket.socket, float] = {}  # in the order of their arrival
        self._guard = threading.Lock()
        self._closing = False
        self._watcher = threading.Thread(target=self._watch, name="waiting DICOM connections", daemon=True)
        super().__init__(
            entity,
            address,
            entity.ae_title,
            entity.supported_contexts,
            evt_handlers=handlers,
            request_handler=_GuardedHandler,
        )
        self._watcher.start()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Let a new connection wait for its first byte."""
        with self._guard:
            if len(self._ends_s) >= MOST_WAITING:
                self._drop(next(iter(self._ends_s)))
            self._ends_s[request] = time.monotonic() + FIRST_BYTE_S
            self._waiting.register(request, selectors.EVENT_READ, client_address)

    def finish_request(self, request: Any, client_address: Any) -> None:
        """Make an association of a connection, in a thread of its own."""
        request.settimeout(FIRST_BYTE_S)
        if self._tls is not None:
            request = self._tls.wrap_socket(request, server_side=True)
        request.settimeout(NETWORK_S)
        super().finish_request(request, client_address)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log a connection that did not become an association, such as by a failed handshake."""
        logger(part="dicom").info("connection failed", address=str(client_address[0]))

    def server_close(self) -> None:
        """Close the server and all waiting connections."""
        self._closing = True
        super().server_close()
        if self._watcher.is_alive() and self._watcher is not threading.current_thread():
            self._watcher.join()
        with self._guard:
            for one in list(self._ends_s):
                self._drop(one)

    def _watch(self) -> None:
        while not self._closing:
            ready = self._waiting.select(WAKE_S)
            with self._guard:
                awake = [key for key, _ in ready if key.fileobj in self._ends_s]
                for key in awake:
                    self._forget(key.fileobj)
                now_s = time.monotonic()
                for one in [one for one, end_s in self._ends_s.items() if end_s < now_s]:
                    self._drop(one)
            for key in awake:
                super().process_request(key.fileobj, key.data)  # type: ignore[arg-type]  # a socket

    def _forget(self, connection: Any) -> None:
        del self._ends_s[connection]
        self._waiting.unregister(connection)

    def _drop(self, connection: socket.socket) -> None:
        self._forget(connection)
        with contextlib.suppress(OSError):
            connection.close()
