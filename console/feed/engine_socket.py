"""The engine's end of the console: JSON lines over a socket, events and replies in, orders out."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import socket

from console.hub import Hub
from procedures.engine.events import Event
from procedures.runs.orders import AnyOrder, Reply

LONGEST_LINE = 1 << 22  # bytes; a question with its tables takes some thousand, an image some 100,000
PAIR = b'{"pair":"'


async def follow_engine(descriptor: int, hub: Hub) -> None:
    """Feed the hub until the engine closes its end."""
    reader, writer = await asyncio.open_connection(sock=socket.socket(fileno=descriptor), limit=LONGEST_LINE)

    async def send(order: AnyOrder) -> None:
        writer.write(order.model_dump_json().encode() + b"\n")
        await writer.drain()

    hub.connect(send)
    try:
        while line := await reader.readline():
            hub.heard()
            _take(hub, line)
    except (OSError, ValueError):
        pass  # not one of our lines: skip it rather than guess
    finally:
        hub.end()
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()


def _take(hub: Hub, line: bytes) -> None:
    if line.startswith(b'{"event":'):
        hub.take(Event.model_validate_json(line.strip()[len(b'{"event":') : -1]))
    elif line.startswith(b'{"beat":'):
        hub.tell()
    elif line.startswith(PAIR):
        hub.take_pair(base64.b64decode(line.strip()[len(PAIR) : -2]))
    elif line.strip():
        hub.reply(Reply.model_validate(json.loads(line)))
