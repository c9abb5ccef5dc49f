"""The listening sockets that serve the pages."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import time
from collections.abc import AsyncIterator

import pytest

from console import listening
from console.guard import SESSION, AccessGuard, Receive, Scope, Send, SessionRole, Sessions
from console.listening import HOST, build_server, listen
from ronna_hw.host import network
from ronna_hw.host.network import find_account

NOBODY = 65534  # an account without rights
SENT_BYTES = 30_000_000  # more than all buffers between two sockets
PING, PONG = b"\x89\x80" + bytes(4), b"\x8a\x00"


class Served:
    """A console with one page and one socket, and what a client of it sends first."""

    def __init__(self) -> None:
        self.listening = listen(HOST, 0)
        self.port = self.listening.getsockname()[1]
        self.sessions = Sessions()
        self.left = asyncio.Event()  # an answer was sent as far as it was read

    @contextlib.asynccontextmanager
    async def serving(self) -> AsyncIterator[Served]:
        trust, is_foreign = self.listening.trust, self.listening.is_foreign
        server = build_server(
            AccessGuard(self._page, self.sessions, self.port, trust=trust, is_foreign=is_foreign)
        )
        task = asyncio.create_task(server.serve(sockets=[self.listening]))
        while not server.started:
            await asyncio.sleep(0)
        yield self
        server.should_exit = True
        await task

    async def connected(self, sent: bytes) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        reader, writer = await asyncio.open_connection(HOST, self.port)
        writer.write(sent)
        return reader, writer

    def request(self, path: str, more: str = "") -> bytes:
        return f"GET {path} HTTP/1.1\r\nHost: {HOST}:{self.port}\r\n{more}\r\n".encode()

    def entered(self) -> bytes:
        return self.request(f"/?token={self.sessions.operator_token}")

    def asked(self, path: str, token: str, more: str = "") -> bytes:
        cookie = self.sessions.open(token)
        return self.request(path, f"Cookie: ronna_console_{self.port}={cookie}\r\n{more}")

    def socket_opened(self, token: str = "") -> bytes:
        return self.asked(
            "/",
            token or self.sessions.operator_token,
            f"Origin: http://{HOST}:{self.port}\r\n"
            "Connection: Upgrade\r\nUpgrade: websocket\r\n"
            "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n",
        )

    async def _page(self, scope: Scope, receive: Receive, send: Send) -> None:
        assert scope["type"] != "http" or SESSION in scope
        message = await receive()
        if scope["type"] == "lifespan":
            await send({"type": "lifespan.startup.complete"})
            await receive()
            await send({"type": "lifespan.shutdown.complete"})
        elif scope["type"] == "websocket":
            await send({"type": "websocket.accept"})
            while message["type"] != "websocket.disconnect":
                message = await receive()
        elif scope["path"] == "/whole":
            length = (b"content-length", str(SENT_BYTES).encode())
            await send({"type": "http.response.start", "status": 200, "headers": [length]})
            await send({"type": "http.response.body", "body": bytes(SENT_BYTES)})
        else:
            await send({"type": "http.response.start", "status": 200, "headers": []})
            for _ in range(SENT_BYTES // 100_000):
                await send({"type": "http.response.body", "body": bytes(100_000), "more_body": True})
            self.left.set()


async def _head(reader: asyncio.StreamReader) -> bytes:
    return await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 10.0)


async def _ended(reader: asyncio.StreamReader) -> bytes:
    """What was said until the server hung up, which it must."""
    said = b""
    with contextlib.suppress(ConnectionError):
        while more := await asyncio.wait_for(reader.read(65536), 10.0):
            said += more
    return said


async def _pinged(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bytes:
    writer.write(PING)
    return await asyncio.wait_for(reader.readexactly(len(PONG)), 10.0)


@pytest.mark.parametrize("line", [b"a:b\r\n", b"a"], ids=["many headers", "one header"])
def test_an_endless_request_head_is_cut_off(line: bytes) -> None:
    async def sent_whole() -> bool:
        async with Served().serving() as console:
            _, writer = await console.connected(b"GET / HTTP/1.1\r\na:")
            try:
                for _ in range(SENT_BYTES // 100_000):
                    writer.write(line * (100_000 // len(line)))
                    await asyncio.wait_for(writer.drain(), 10.0)
            except ConnectionError:
                return False
            finally:
                writer.transport.abort()
        return True

    assert not asyncio.run(sent_whole())


def test_a_complete_request_head_beyond_the_limit_is_refused() -> None:
    async def said() -> bytes:
        async with Served().serving() as console:
            reader, writer = await console.connected(console.request("/", f"x: {'a' * 60_000}\r\n"))
            head = await _head(reader)
            writer.transport.abort()
            return head

    assert b" 431 " in asyncio.run(said())


def test_a_socket_whose_head_is_refused_before_the_guard_is_disconnected() -> None:
    async def said() -> bytes:
        async with Served().serving() as console:
            head = console.socket_opened().removesuffix(b"\r\n")
            reader, writer = await console.connected(head + b"x: " + b"a" * 9000 + b"\r\n\r\n")
            said = await _ended(reader)
            writer.close()
            return said

    assert asyncio.run(said()) == b""


@pytest.fixture
def short_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listening, "REQUEST_LIMIT_S", 0.1)


@pytest.mark.usefixtures("short_limit")
@pytest.mark.parametrize("half", [b"", b"GET / HT", b"GET / HTTP/1.1\r\nHost: a\r\n"])
@pytest.mark.parametrize("answered", [b"", b"GET / HTTP/1.1\r\nHost: a\r\n\r\n"], ids=["first", "second"])
def test_an_incomplete_request_is_disconnected_after_the_time_limit(answered: bytes, half: bytes) -> None:
    async def said() -> bytes:
        async with Served().serving() as console:
            reader, writer = await console.connected(answered + half)
            said = await _ended(reader)
            writer.close()
            return said

    assert (b" 421 " in asyncio.run(said())) == bool(answered)


@pytest.mark.usefixtures("short_limit")
def test_a_slowly_sent_request_gets_no_more_time_than_any_other() -> None:
    async def drip() -> None:
        async with Served().serving() as console:
            reader, writer = await console.connected(b"GET / HTTP/1.1\r\n")
            with contextlib.suppress(ConnectionError):
                while not reader.at_eof():
                    writer.write(b"a:b\r\n")
                    await writer.drain()
                    await asyncio.sleep(0.01)
            writer.close()

    asyncio.run(asyncio.wait_for(drip(), 10.0))


def test_connections_without_the_key_do_not_lock_out_the_operator(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listening, "MOST_STRANGERS", 4)

    async def come() -> None:
        async with Served().serving() as console:
            operator = await console.connected(console.socket_opened())
            assert b" 101 " in await _head(operator[0])
            strangers = [await console.connected(b"") for _ in range(12)]
            for reader, _ in strangers[:8]:
                assert await _ended(reader) == b""
            another = await console.connected(console.entered())
            assert b" 303 " in await _head(another[0])
            assert await _pinged(*operator) == PONG
            for _, writer in (operator, another, *strangers):
                writer.transport.abort()

    asyncio.run(come())


def test_a_viewer_with_too_many_connections_gets_no_more_and_locks_out_no_operator(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(listening.MOST_CONNECTIONS, SessionRole.VIEWER, 2)

    async def come() -> None:
        async with Served().serving() as console:
            viewer = console.sessions.viewer_token
            viewers = [await console.connected(console.socket_opened(viewer)) for _ in range(2)]
            for reader, _ in viewers:
                assert b" 101 " in await _head(reader)
            for one_more, answer in (
                (console.asked("/state", viewer), b" 503 "),
                (console.socket_opened(viewer), b" 403 "),
            ):
                reader, writer = await console.connected(one_more)
                assert answer in (await _ended(reader)).partition(b"\r\n")[0]
                writer.close()
            operator = await console.connected(console.socket_opened())
            assert b" 101 " in await _head(operator[0])
            viewers[0][1].transport.abort()
            await asyncio.wait_for(_again(console, viewer), 10.0)
            for _, writer in (operator, *viewers):
                writer.transport.abort()

    async def _again(console: Served, viewer: str) -> None:
        """Until the server has noticed that there is room."""
        said = b""
        while b" 101 " not in said:
            reader, writer = await console.connected(console.socket_opened(viewer))
            said = await reader.readuntil(b"\r\n\r\n")
            writer.transport.abort()

    asyncio.run(come())


def test_an_answer_that_is_not_read_is_given_up_after_its_time_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listening, "ANSWER_LIMIT_S", 0.1)

    async def stay() -> None:
        async with Served().serving() as console:
            _, writer = await console.connected(console.asked("/", console.sessions.viewer_token))
            await asyncio.wait_for(console.left.wait(), 10.0)
            writer.transport.abort()

    asyncio.run(stay())


@pytest.mark.usefixtures("short_limit")
def test_an_answer_in_one_piece_is_left_to_a_slow_reader() -> None:
    async def taken() -> int:
        async with Served().serving() as console:
            reader, writer = await console.connected(console.asked("/whole", console.sessions.viewer_token))
            await _head(reader)
            stranger = await console.connected(b"")
            await _ended(stranger[0])  # has come later, and its time is up
            answer = await asyncio.wait_for(reader.readexactly(SENT_BYTES), 60.0)
            for one in (writer, stranger[1]):
                one.transport.abort()
            return len(answer)

    assert asyncio.run(taken()) == SENT_BYTES


@pytest.mark.usefixtures("short_limit")
def test_an_open_socket_outlasts_the_request_time_limit() -> None:
    async def stay() -> None:
        async with Served().serving() as console:
            operator = await console.connected(console.socket_opened())
            assert b" 101 " in await _head(operator[0])
            stranger = await console.connected(b"")
            await _ended(stranger[0])  # has come later
            assert await _pinged(*operator) == PONG
            for _, writer in (operator, stranger):
                writer.transport.abort()

    asyncio.run(stay())


def test_accepted_connections_use_tcp_nodelay() -> None:
    async def delays() -> int:
        came: asyncio.Future[int] = asyncio.get_running_loop().create_future()

        def connected(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            theirs = writer.get_extra_info("socket")
            came.set_result(theirs.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            writer.close()

        bound = listen(HOST, 0)
        async with await asyncio.start_server(connected, sock=bound):
            _, writer = await asyncio.open_connection(*bound.getsockname())
            writer.close()
            return await asyncio.wait_for(came, 5.0)

    assert asyncio.run(delays()) != 0


@pytest.mark.parametrize("source", [HOST, "127.0.0.9"])
def test_another_account_of_this_computer_is_refused_though_it_has_the_cookie(
    monkeypatch: pytest.MonkeyPatch, source: str
) -> None:
    async def heads() -> list[bytes]:
        async with Served().serving() as console:
            own = os.geteuid()
            monkeypatch.setattr(listening.os, "geteuid", lambda: own + 1)  # all of ours are foreign now
            found = []
            for sent in (console.entered(), console.socket_opened()):
                reader, writer = await asyncio.open_connection(HOST, console.port, local_addr=(source, 0))
                writer.write(sent)
                found.append(await _head(reader))
                writer.transport.abort()
            return found

    assert [b" 403 " in head for head in asyncio.run(heads())] == [True, True]


def test_the_account_of_a_connection_costs_the_same_however_many_there_are() -> None:
    with listen(HOST, 0) as bound, contextlib.ExitStack() as stack:
        stack.enter_context(socket.create_connection(bound.getsockname()))
        connection, peer = bound.accept()
        stack.enter_context(connection)

        def cost_s() -> float:
            begun_s = time.process_time()
            for _ in range(200):
                assert find_account(peer, bound.getsockname()) == os.geteuid()
            return time.process_time() - begun_s

        alone_s = cost_s()
        for _ in range(500):  # a stranger lists as many as he likes
            stack.enter_context(socket.create_server((HOST, 0)))
        assert cost_s() < 5 * alone_s


@pytest.fixture(params=["sock_diag", "without sock_diag"])
def diagnosis(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """How the account of a connection is found."""
    if request.param != "sock_diag":
        monkeypatch.setattr(network, "_diagnosed", lambda _local, _remote: None)


@pytest.mark.usefixtures("diagnosis")
def test_a_connection_whose_program_has_gone_belongs_to_no_account() -> None:
    with listen(HOST, 0) as bound:
        with socket.create_connection(bound.getsockname()) as client:
            assert find_account(client.getsockname(), bound.getsockname()) == os.geteuid()
            connection, peer = bound.accept()
            assert not bound.is_foreign(peer)
        with connection:
            assert find_account(peer, bound.getsockname()) is None


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can act as another account")
@pytest.mark.usefixtures("diagnosis")
def test_the_account_of_a_connection_is_the_one_that_made_it() -> None:
    with listen(HOST, 0) as bound, contextlib.ExitStack() as stack:
        os.seteuid(NOBODY)
        try:
            stack.enter_context(socket.create_connection(bound.getsockname()))
        finally:
            os.seteuid(0)
        connection, peer = bound.accept()
        stack.enter_context(connection)
        assert find_account(peer, connection.getsockname()) == NOBODY
        assert bound.is_foreign(peer)
