"""Connection to an OpenIGTLink server, with a thread that reads what the server sends unasked.

The thread reads whether anybody waits or not: a client that does not read holds up servers such as PLUS, and
finds old poses when it reads again.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time

from drivers.openigtlink_tracker.errors import (
    NO_MEASUREMENT,
    NO_SERVER,
    SERVER_UNAVAILABLE,
    ServerLost,
    SharedName,
    StreamGarbled,
)
from drivers.openigtlink_tracker.measurements import Assembler, Measurement
from drivers.openigtlink_tracker.options import OpenIGTLinkOptions
from ronna_hw.clock import Clock
from ronna_hw.devices.capabilities import ByteSink, Direction
from ronna_hw.endpoints import Endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.wire.openigtlink import (
    LONGEST_NAME_BYTES,
    Malformed,
    Message,
    MessageReader,
    StreamBroken,
    encode_message,
)
from ronna_hw.wire.openigtlink_contents import StatusCode, Subscription, decode_status, encode_subscription

RECEIVE_BYTES = 65536
LARGEST_BODY_BYTES = 1 << 26  # PLUS sends the pictures of its other devices as well, unless told otherwise
JOIN_LIMIT_S = 1.0
# PLUS compares this number of milliseconds with seconds: only zero has the same meaning everywhere.
SHORTEST_INTERVAL_MS = 0


class Connection:
    """Open connection; its thread assembles measurements until `close`, or until the server is lost."""

    def __init__(
        self,
        name: str,
        endpoint: Endpoint,
        options: OpenIGTLinkOptions,
        clock: Clock,
        sink: ByteSink | None,
        timeout_s: float,
    ) -> None:
        """Connect and start reading. Raises IGT-001."""
        self._name, self._endpoint, self._options, self._clock = name, endpoint, options, clock
        self._sink = sink
        try:
            self._socket = socket.create_connection((endpoint.host, endpoint.port), timeout_s)
        except OSError as error:
            raise SERVER_UNAVAILABLE(f"{endpoint}: {error.strerror or error}") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(None)
        self._changed = threading.Condition()
        self._assembler = Assembler(options, time.monotonic())
        self._failure: RonnaError | None = None
        self._heard_s: float | None = None  # host time of the last message
        self._version = 1  # highest header version that the server has sent
        self.disturbed = 0  # messages with a wrong check sum or content
        self.complaint = ""  # the server's last STATUS, unless it was OK
        self._thread = threading.Thread(target=self._read_on, name=f"{name} reader", daemon=True)
        self._thread.start()

    @property
    def names(self) -> set[str]:
        """Names of all transforms that the server has sent."""
        with self._changed:
            return set(self._assembler.names)

    @property
    def count(self) -> int:
        """Number of measurements so far."""
        return self._assembler.count

    def greet(self, timeout_s: float) -> None:
        """Ask for the server's status and wait for any message. Raises IGT-002, IGT-006 and IGT-007.

        The query has no content that a server without header version 2 could misread.
        """
        self._send("GET_STATUS", version=self._options.header_version)
        with self._changed:
            self._changed.wait_for(lambda: self._heard_s is not None or self._failure, timeout_s)
            if self._heard_s is None:
                if self._failure is not None:
                    raise self._failure
                raise NO_SERVER(f"{self._endpoint} has sent no message", limit=f"{timeout_s:.1f} s")

    def await_names(self, wanted: set[str], timeout_s: float) -> bool:
        """Wait until transforms of all these names, cut as servers cut them, have been sent.

        Returns whether they have. Raises IGT-006 to IGT-008 once the connection has failed.
        """

        def have_come() -> bool:
            return bool(wanted) and wanted <= {name[:LONGEST_NAME_BYTES] for name in self._assembler.names}

        with self._changed:
            self._changed.wait_for(lambda: have_come() or self._failure is not None, timeout_s)
            if self._failure is not None:
                raise self._failure
            return have_come()

    def start(self) -> None:
        """Ask for TDATA, which a server may ignore: many send TRANSFORM messages unasked."""
        subscription = Subscription(SHORTEST_INTERVAL_MS, self._options.frame)
        self._send("STT_TDATA", encode_subscription(subscription), version=self._version)

    def stop(self) -> None:
        """End TDATA."""
        self._send("STP_TDATA", version=self._version)

    def await_newer(self, than: int, timeout_s: float) -> Measurement:
        """Return the newest measurement with a higher number, waiting for one if needed.

        Raises IGT-005 when none comes in time; IGT-006 to IGT-008 once the connection has failed.
        """
        deadline_s = time.monotonic() + timeout_s
        with self._changed:
            while True:
                now_s = time.monotonic()
                self._assembler.close_overdue(now_s)
                self._look_for_silence(now_s)
                newest = self._assembler.newest
                if newest is not None and newest.number > than:
                    return newest
                if self._failure is not None:
                    raise self._failure
                if now_s >= deadline_s:
                    raise NO_MEASUREMENT(
                        f"{self._endpoint} has sent no new measurement",
                        limit=f"{timeout_s:g} s",
                        got=self.complaint or None,
                    )
                self._changed.wait(min(deadline_s - now_s, self._options.hidden_after_s / 2))

    def close(self) -> None:
        """Close the connection and wait for the thread, in bounded time."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join(JOIN_LIMIT_S)
        self._socket.close()

    def _look_for_silence(self, now_s: float) -> None:
        """Note a lost server; note missing tools where only other messages, such as STATUS, still come."""
        heard_s, limits = self._heard_s, self._options
        if heard_s is None or self._failure is not None:
            return
        if now_s - heard_s > limits.silence_limit_s:
            self._failure = ServerLost(
                f"{self._endpoint} is silent", limit=f"{limits.silence_limit_s:g} s without any message"
            )
        elif heard_s - self._assembler.last_s >= limits.hidden_after_s:
            self._assembler.add_empty(self._clock.now_s(), now_s)

    def _send(self, kind: str, content: bytes = b"", *, version: int) -> None:
        data = encode_message(kind, "", content, version=version)
        if self._sink is not None:
            self._sink.on_bytes(self._name, Direction.SENT, data)
        with contextlib.suppress(OSError):  # the reading thread learns of a lost connection as well
            self._socket.sendall(data)

    def _read_on(self) -> None:
        reader = MessageReader(LARGEST_BODY_BYTES)
        while True:
            try:
                data = self._socket.recv(RECEIVE_BYTES)
            except OSError as error:
                return self._fail(ServerLost(f"{self._endpoint}: {error.strerror or error}"))
            if not data:
                return self._fail(ServerLost(f"{self._endpoint} has closed the connection"))
            if self._sink is not None:
                self._sink.on_bytes(self._name, Direction.RECEIVED, data)
            try:
                with self._changed:
                    for message in reader.feed(data):
                        self._take(message)
                    self._changed.notify_all()
            except StreamBroken as error:
                return self._fail(StreamGarbled(f"{self._endpoint}: {error}", wire=data))
            except SharedName as error:
                return self._fail(error)

    def _take(self, message: Message) -> None:
        now_s = self._heard_s = time.monotonic()
        self._version = max(self._version, message.version)
        try:
            if message.fault:
                raise Malformed(message.fault)
            if message.kind == "STATUS":
                status = decode_status(message.content)
                self.complaint = (
                    "" if status.code == StatusCode.OK else f"{status.error} {status.text}".strip()
                )
            elif message.kind in ("TDATA", "TRANSFORM"):
                self._assembler.add(message, self._clock.now_s(), now_s)
        except Malformed:
            self.disturbed += 1

    def _fail(self, failure: RonnaError) -> None:
        with self._changed:
            self._failure = self._failure or failure
            self._changed.notify_all()
