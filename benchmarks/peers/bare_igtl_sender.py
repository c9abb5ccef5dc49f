"""A bare asyncio sender: the same bytes to every client, at a fixed rate, from no feed and with no rule.

Arguments: messages at a time, times per second. Prints READY with its port.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys

from ronna_hw.wire.openigtlink import encode_message
from sim.world.process import end_with_parent

FULL_BYTES = 1 << 16  # a client that takes nothing gets nothing more


async def send(messages: int, rate_hz: float) -> None:
    loop = asyncio.get_running_loop()
    clients: list[asyncio.StreamWriter] = []

    async def admit(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        clients.append(writer)

    server = await asyncio.start_server(admit, "127.0.0.1", 0)
    print("READY " + json.dumps({"port": server.sockets[0].getsockname()[1]}), flush=True)
    frame = b"".join(encode_message("TRANSFORM", f"Tool{n}ToRobot", bytes(48)) for n in range(messages))
    due_s = loop.time()
    while True:
        due_s += 1.0 / rate_hz
        await asyncio.sleep(due_s - loop.time())
        for client in clients:
            if client.transport.get_write_buffer_size() < FULL_BYTES:
                client.write(frame)


def main() -> None:
    end_with_parent(lambda: os._exit(0))
    asyncio.run(send(int(sys.argv[1]), float(sys.argv[2])))


if __name__ == "__main__":
    main()
