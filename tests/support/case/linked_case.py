"""A case that a test tells record by record, with its OpenIGTLink server in a thread, and a plain client."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from procedures.live.openigtlink.server import LinkServer, ServerOptions
from procedures.live.records import (
    Began,
    DeviceStatus,
    Fiducial,
    Fiducials,
    FramePose,
    LiveRecord,
    PlannedLine,
    PlannedLines,
    RunState,
)
from ronna_hw.wire.openigtlink import Message, MessageReader, encode_message

EPOCH_NS = 1_700_000_000_000_000_000
BEGAN = Began(theatre_time_s=0.0, run="R1", epoch_ns=EPOCH_NS)
AWAITED_S = 20.0  # host time, for what comes at once
QUARTER_TURN = (0.5**0.5, 0.0, 0.0, 0.5**0.5)  # about z, from x to y
CHUNK_BYTES = 1 << 16


def pose(child: str, parent: str, time_s: float = 1.0, x_mm: float = 10.0) -> FramePose:
    """A quarter turn about z and a shift: its transpose is another rotation, its inverse another place."""
    return FramePose(
        theatre_time_s=time_s,
        parent=parent,
        child=child,
        rotation=QUARTER_TURN,
        translation_mm=(x_mm, 20.0, 30.0),
    )


SPHERE = Fiducial(name="M1", position_mm=(1.0, 2.0, 3.0), diameter_mm=10.0, residual_mm=0.25, is_used=True)
LINE = PlannedLine(name="T1", entry_mm=(1.0, 2.0, 3.0), target_mm=(4.0, 5.0, 6.0))
STANDING = (  # a case as it stands when a client comes
    pose("robot", "ct").model_copy(update={"is_fixed": True}),
    DeviceStatus(
        theatre_time_s=1.0, device="tracker", state="fault", code="NDI-004", text="away", advice="Look."
    ),
    RunState(theatre_time_s=1.0, run="R1", state="idle"),
    Fiducials(theatre_time_s=1.0, spheres=(SPHERE,)),
    PlannedLines(theatre_time_s=1.0, lines=(LINE,)),
)
TOOL_IN_RAS = [[1, 0, 0, 10], [0, 1, 0, -30], [0, 0, 1, 60]]  # see test_openigtlink_server


@dataclass
class LinkedCase:
    """The server's address, and the feed that it reads."""

    port: int
    _loop: asyncio.AbstractEventLoop
    _records: asyncio.Queue[LiveRecord | None]
    clients: list[PlainClient] = field(default_factory=list)

    def tell(self, *records: LiveRecord | None) -> None:
        """Pass records on; None ends the case."""
        for record in records:
            self._loop.call_soon_threadsafe(self._records.put_nowait, record)

    def connect(self) -> PlainClient:
        """Connect, and wait until the server has admitted the client: it gets all from now on."""
        client = self.connect_unseen()
        client.send("GET_CAPABIL")
        _, before = client.until(lambda one: one.kind == "CAPABILITY")
        client.put_back(before)
        return client

    def connect_unseen(self) -> PlainClient:
        """Connect only."""
        self.clients.append(PlainClient(self.port))
        return self.clients[-1]


@contextmanager
def linked_case(options: ServerOptions | None = None) -> Iterator[LinkedCase]:
    """A case that has begun, served at a free port. At the end, the case ends."""
    options = replace(options or ServerOptions(), port=0)
    served: list[LinkedCase] = []
    is_ready = threading.Event()
    failed: list[BaseException] = []

    async def serve() -> None:
        records: asyncio.Queue[LiveRecord | None] = asyncio.Queue()
        records.put_nowait(BEGAN)

        async def read() -> AsyncIterator[LiveRecord]:
            while (record := await records.get()) is not None:
                yield record

        def ready(_host: str, port: int) -> None:
            served.append(LinkedCase(port, asyncio.get_running_loop(), records))
            is_ready.set()

        try:
            await LinkServer(options, lambda _line: None).serve(read(), ready)
        except BaseException as error:
            failed.append(error)
            raise

    thread = threading.Thread(target=lambda: asyncio.run(serve()), daemon=True)
    thread.start()
    assert is_ready.wait(AWAITED_S), failed
    try:
        yield served[0]
    finally:
        served[0].tell(None)
        for client in served[0].clients:
            client.socket.close()
        thread.join(AWAITED_S)
    assert not thread.is_alive()
    assert failed == []


@contextmanager
def moving(case: LinkedCase) -> Iterator[None]:
    """The tool moves during the block: strangers connect when they like, and get what comes from then on."""
    ended = threading.Event()

    def move() -> None:
        while not ended.wait(0.01):
            case.tell(pose("tool", "robot", 2.5))

    thread = threading.Thread(target=move)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


class PlainClient:
    """Client that counts: a socket and our reader. Strangers read the contents elsewhere."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), AWAITED_S)
        self._reader = MessageReader(largest_body_bytes=1 << 28)
        self._waiting: list[Message] = []

    def __enter__(self) -> PlainClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def send(self, kind: str, name: str = "", content: bytes = b"", version: int = 1) -> None:
        self.socket.sendall(encode_message(kind, name, content, version=version))

    def messages(self) -> Iterator[Message]:
        """Messages in the order of their arrival, until the server closes."""
        while True:
            while self._waiting:
                yield self._waiting.pop(0)
            if not (data := self.socket.recv(CHUNK_BYTES)):
                return
            self._waiting += self._reader.feed(data)

    def until(self, wanted: Callable[[Message], bool]) -> tuple[Message, list[Message]]:
        """Read to a message that is wanted; return it and those before it."""
        before: list[Message] = []
        for message in self.messages():
            if wanted(message):
                return message, before
            before.append(message)
        raise AssertionError(f"closed after {[(one.kind, one.name) for one in before]}")

    def ask_for_metadata(self) -> None:
        """Use a header of version 2, and wait until the server has seen it."""
        self.send("GET_CAPABIL", version=2)
        self.first("CAPABILITY")

    def put_back(self, messages: list[Message]) -> None:
        self._waiting = messages + self._waiting

    def first(self, kind: str, name: str | None = None) -> Message:
        return self.until(lambda one: one.kind == kind and name in (None, one.name))[0]
