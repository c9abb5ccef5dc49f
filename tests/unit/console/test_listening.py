"""The sockets behind which the pages are served."""

from __future__ import annotations

import asyncio
import socket

from console.listening import HOST, listen


def test_what_is_sent_does_not_wait_until_what_went_before_was_heard() -> None:
    async def delays() -> int:
        came: asyncio.Future[int] = asyncio.get_running_loop().create_future()

        def connected(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            theirs = writer.get_extra_info("socket")
            came.set_result(theirs.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            writer.close()

        listening = listen(HOST, 0)
        async with await asyncio.start_server(connected, sock=listening):
            _, writer = await asyncio.open_connection(*listening.getsockname())
            writer.close()
            return await asyncio.wait_for(came, 5.0)

    assert asyncio.run(delays()) != 0
