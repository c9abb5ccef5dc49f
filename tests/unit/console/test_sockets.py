"""Messages on a socket of the page library, bound to the session that owns their page."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from console.guard import SESSION, Role, Session
from console.web.library import bind_sockets, own_page


class Library:
    """The little of the page library's socket server that is bound; notes what came through."""

    def __init__(self) -> None:
        self.heard: list[tuple[str, Any]] = []
        names = ("event", "javascript_response", "ack", "log")
        self.handlers = {"/": {name: self._handler(name) for name in names}}
        self.handlers["/"] |= {"handshake": self._shake, "connect": self._shake}
        self.sessions: dict[str, Session] = {}

    def _handler(self, name: str) -> Any:
        def handle(_sid: str, message: dict[str, Any]) -> None:
            self.heard.append((name, message["id"]))

        return handle

    async def _shake(self, sid: str, *_: Any) -> bool:
        self.heard.append(("hello", sid))
        return True

    def on(self, name: str, handler: Any) -> None:
        self.handlers["/"][name] = handler

    def get_environ(self, sid: str) -> dict[str, Any]:
        return {"asgi.scope": {SESSION: self.sessions[sid]}}


@pytest.fixture
def library() -> Library:
    library = Library()
    library.sessions = {"a": Session(Role.OPERATOR, "ana"), "b": Session(Role.VIEWER, "ben")}
    bind_sockets(library)
    own_page(SimpleNamespace(id="page-of-ana", on_delete=lambda _: None), "ana")
    return library


@pytest.mark.parametrize("name", ["event", "javascript_response", "ack", "log"])
def test_a_socket_accepts_messages_only_for_pages_of_its_own_session(library: Library, name: str) -> None:
    handler = library.handlers["/"][name]
    handler("b", {"client_id": "page-of-ana", "id": 1})
    handler("a", {"client_id": "page-of-ana", "id": 2})
    handler("a", {"client_id": "page-of-nobody", "id": 3})
    assert library.heard == [(name, 2)]


@pytest.mark.parametrize("message", [None, 7, "x", [], {}, {"client_id": 7}, {"client_id": "page-of-ana"}])
def test_a_malformed_message_is_dropped(library: Library, message: Any) -> None:
    library.handlers["/"]["event"]("a", message)
    assert library.heard == []


def test_a_page_accepts_a_connection_only_from_its_own_session(library: Library) -> None:
    shake = library.handlers["/"]["handshake"]
    assert not asyncio.run(shake("b", {"client_id": "page-of-ana"}))
    assert not asyncio.run(shake("a", None))
    assert asyncio.run(shake("a", {"client_id": "page-of-ana"}))
    connect = library.handlers["/"]["connect"]
    environ = library.get_environ("b") | {"QUERY_STRING": "implicit_handshake=true&client_id=page-of-ana"}
    assert asyncio.run(connect("b", environ)) is False
