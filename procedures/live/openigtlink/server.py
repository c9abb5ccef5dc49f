"""OpenIGTLink server of one running case. Clients see it; nothing that they send reaches it."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import socket
from collections.abc import AsyncIterator, Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from procedures.live.errors import ADDRESS_UNUSABLE
from procedures.live.openigtlink.answers import SUBSCRIPTIONS, answer, nothing, status
from procedures.live.openigtlink.connection import Connection
from procedures.live.openigtlink.images import Images
from procedures.live.openigtlink.names import CAMERA_IMAGES, FRAME_WORDS, SERVER
from procedures.live.openigtlink.outgoing import Outgoing
from procedures.live.openigtlink.poses import TRANSFORM
from procedures.live.openigtlink.throttle import Throttle
from procedures.live.openigtlink.values import LinkValues
from procedures.live.records import LiveRecord
from ronna_hw.errors import RonnaError
from ronna_hw.wire.openigtlink import PORT, Malformed, Message
from ronna_hw.wire.openigtlink_contents import StatusCode, decode_subscription

LOOPBACK: Final = "127.0.0.1"
MOST_CLIENTS: Final = 16
REPEAT_S: Final = 1.0
STALLED_S: Final = 60.0  # a client that takes nothing for so long gives its place to others
CLOSE_LIMIT_S: Final = 1.0  # for what clients have not yet received when the case ends
RATE_HZ: Final = 30.0
STARTED: Final = b"\0"  # content of RTS_TDATA: success, and otherwise
NOT_STARTED: Final = b"\1"
MS_PER_S: Final = 1000.0


@dataclass(frozen=True)
class ServerOptions:
    """Options of the server. Port 0 is any free one."""

    host: str = LOOPBACK
    port: int = PORT
    rate_hz: float = RATE_HZ
    header_version: int = 1
    ct: Path | None = None  # folder of the series


class LinkServer:
    """Server of the values of one case."""

    def __init__(self, options: ServerOptions, tell: Callable[[str], None]) -> None:
        """`tell` shows a line to the user. Raises LIV-010 if a name does not fit."""
        self._tell = tell
        self._options = options
        self._values = LinkValues()
        self._connections: list[Connection] = []
        self._throttles: dict[str, Throttle[Outgoing]] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._images = Images(self._values, options.ct)
        self._told: set[str] = set()

    async def serve(self, records: AsyncIterator[LiveRecord], ready: Callable[[str, int], None]) -> None:
        """Serve the records until they end; `ready` gets address and port. Raises LIV-011 and theirs."""
        if (first := await anext(records, None)) is None:
            return
        self._take(first)
        server = await self._listen()
        host, port = server.sockets[0].getsockname()[:2]
        ready(host, port)
        repeating = asyncio.create_task(self._repeat())
        try:
            async for record in records:
                self._take(record)
        finally:
            repeating.cancel()
            server.close()
            await self._say_goodbye()

    async def _listen(self) -> asyncio.Server:
        host, port = self._options.host, self._options.port
        loop = asyncio.get_running_loop()
        try:
            return await loop.create_server(
                lambda: Connection(self, self._options.header_version), host, port, backlog=MOST_CLIENTS
            )
        except OSError as error:
            is_name = isinstance(error, socket.gaierror)
            got = f"{host} is no address" if is_name else os.strerror(error.errno or errno.EIO)
            raise ADDRESS_UNUSABLE(f"cannot listen at {host}:{port}", got=got) from error

    def _take(self, record: LiveRecord) -> None:
        try:
            changed = self._values.take(record)
        except RonnaError as error:  # a name that does not fit: the others go on
            if str(error) not in self._told:
                self._told.add(str(error))
                self._tell(f"not sent: {error}")
                self._offer(status(StatusCode.CONFIGURATION_ERROR, str(error), error.code))
            return
        for value in changed:
            if value.kind == TRANSFORM:
                self._throttle(value.name).offer(value)
            else:
                self._offer(value)

    def _throttle(self, name: str) -> Throttle[Outgoing]:
        if (throttle := self._throttles.get(name)) is None:
            throttle = self._throttles[name] = Throttle(1.0 / self._options.rate_hz, self._offer_pose)
        return throttle

    def _offer_pose(self, value: Outgoing) -> None:
        self._offer(value)
        for connection in self._connections:
            connection.note_pose()

    def _offer(self, value: Outgoing) -> None:
        for connection in self._connections:
            connection.offer(value)

    async def _repeat(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(REPEAT_S)
            for value in self._values.repeated:
                self._offer(value)
            for connection in list(self._connections):
                since_s = connection.stalled_since_s
                if since_s is not None and loop.time() - since_s > STALLED_S:
                    self._tell(f"a client that takes nothing for {STALLED_S:g} s is disconnected")
                    connection.abort()

    async def _say_goodbye(self) -> None:
        for task in self._tasks:
            task.cancel()
        for connection in self._connections:
            connection.offer(status(StatusCode.SHUTTING_DOWN, "The case has ended."))
            connection.close()
        deadline_s = asyncio.get_running_loop().time() + CLOSE_LIMIT_S
        while self._connections and asyncio.get_running_loop().time() < deadline_s:
            await asyncio.sleep(CLOSE_LIMIT_S / 50)
        for connection in list(self._connections):
            connection.abort()

    def admit(self, connection: Connection) -> None:
        """Send a new client all that stands; a further one than the most is told and closed."""
        if len(self._connections) >= MOST_CLIENTS:
            connection.offer(
                status(StatusCode.BUSY, f"{MOST_CLIENTS} clients are connected.", "TooManyClients")
            )
            connection.close()
            return
        self._connections.append(connection)
        self.welcome(connection)

    def welcome(self, connection: Connection) -> None:
        """Send a client all that stands."""
        for value in self._values.standing:
            connection.offer(value)

    def dismiss(self, connection: Connection) -> None:
        """Forget a client that is gone."""
        with contextlib.suppress(ValueError):  # it was refused
            self._connections.remove(connection)

    def break_off(self, connection: Connection, reason: str) -> None:
        """Tell a client why its stream cannot be read on, and close it."""
        connection.offer(status(StatusCode.UNKNOWN_INSTRUCTION, reason, "NotOpenIGTLink"))
        connection.close()

    def receive(self, connection: Connection, message: Message) -> None:
        """Answer a client's message."""
        if not message.fault and message.kind == "GET_IMAGE":
            self._begin_image(connection, message.name)
        elif not message.fault and message.kind in SUBSCRIPTIONS:
            self._change_subscription(connection, SUBSCRIPTIONS[message.kind], message)
        else:
            for reply in answer(message, self._values.latest, connection.version):
                connection.reply(reply)

    def _change_subscription(self, connection: Connection, kind: str, message: Message) -> None:
        connection.unsubscribe(kind)
        state = STARTED
        if message.kind.startswith("STT_"):
            try:
                wanted = decode_subscription(message.content)
            except Malformed as error:
                connection.reply(status(StatusCode.CHECKSUM_ERROR, str(error), "NotIntact"))
                return
            if wanted.frame and wanted.frame not in FRAME_WORDS:
                text = f"There is no frame of that name; there are {', '.join(sorted(FRAME_WORDS))}."
                connection.reply(status(StatusCode.CONFIGURATION_ERROR, text, "UnknownFrame"))
                state = NOT_STARTED
            else:
                interval_s = max(wanted.interval_ms / MS_PER_S, 1.0 / self._options.rate_hz)
                connection.subscribe(kind, interval_s, lambda: self._values.tracking(kind, wanted.frame))
        connection.reply(Outgoing(f"RTS_{kind}", SERVER, state))

    def _begin_image(self, connection: Connection, name: str) -> None:
        if connection.has_image_request:
            text = "The last image that was asked for is not ready."
            connection.reply(status(StatusCode.BUSY, text, "Busy"))
            return
        connection.has_image_request = True
        task = asyncio.create_task(self._send_images(connection, (name,) if name else CAMERA_IMAGES.values()))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _send_images(self, connection: Connection, names: Iterable[str]) -> None:
        try:
            for name in names:
                image = await self._images.find(name, connection.version)
                connection.reply(nothing("IMAGE", name) if image is None else image)
        except (OSError, ValueError) as error:
            connection.reply(status(StatusCode.NOT_READY, str(error), "NotReadable"))
        finally:
            connection.has_image_request = False
