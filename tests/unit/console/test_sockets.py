"""Sockets may only address pages of their own session, and malformed messages are dropped."""

from __future__ import annotations

import asyncio
import json
import random
from types import SimpleNamespace
from typing import Any

import pytest
from nicegui import Client, core, ui

from console.guard import SESSION, Session, SessionRole
from console.panels.orders import OrderPanel
from console.web.library import FROM_PAGES, bind_page, bind_sockets
from procedures.engine.case_view import CaseView
from procedures.engine.events import Waiting


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
    library.sessions = {"a": Session(SessionRole.OPERATOR, "ana"), "b": Session(SessionRole.VIEWER, "ben")}
    bind_sockets(library)
    bind_page(SimpleNamespace(id="page-of-ana", on_delete=lambda _: None), "ana")
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


ODD = (None, True, -1, 2**70, 1e308, "", "\0", "é" * 300, [], {}, [[]], {"a": []})
ODD_ARGUMENTS = ("", "{", "null", "1e999", "[" * 5000, '{"timeStamp": NaN}', '{"key": " "}', '"\\ud800"')
DEEP: list[Any] = []
for _ in range(5000):
    DEEP = [DEEP]
HERS, HIS = Session(SessionRole.OPERATOR, "ana"), Session(SessionRole.OPERATOR, "ben")


class OpenPage:
    """The library's own handlers behind the check, and the orders that its buttons gave."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, is_mine: bool) -> None:
        self.orders: list[dict[str, Any]] = []
        handlers = core.sio.handlers
        monkeypatch.setitem(handlers, "/", dict(handlers["/"]))
        sockets = {"hers": HERS, "his": HIS}
        monkeypatch.setattr(core.sio, "get_environ", lambda sid: {"asgi.scope": {SESSION: sockets[sid]}})
        bind_sockets(core.sio)
        self._handlers = handlers["/"]
        with Client(ui.page("/of-a-test"), request=None) as self.client:
            panel = OrderPanel(self._give, lambda _words: None)
            panel.show(CaseView(waiting=Waiting(upcoming="image")), is_mine=is_mine)
        self.client.tab_id = "tab"
        bind_page(self.client, HERS.identifier)
        self.next = panel._next
        self.listeners = [
            (element.id, listener)
            for element in self.client.elements.values()
            for listener in element._event_listeners
        ]

    async def _give(self, order: dict[str, Any]) -> None:
        self.orders.append(order)

    def click(self) -> dict[str, Any]:
        """The message of a click on Next."""
        listener = next(one for at, one in self.listeners if at == self.next.id)
        return {"id": self.next.id, "client_id": self.client.id, "listener_id": listener, "args": ["{}"]}

    def mutant(self, draw: random.Random) -> dict[str, Any]:
        """A message of this page with some of it changed, left out or put in."""
        element, listener = draw.choice(self.listeners)
        message = self.click() | {"id": element, "listener_id": listener}
        for _ in range(draw.randint(1, 3)):
            name = draw.choice(
                [*message, "args", "more", "level", "message", "request_id", "next_message_id"]
            )
            match draw.randrange(5):
                case 0:
                    message.pop(name, None)
                case 1:
                    message[name] = draw.choice(ODD)
                case 2:
                    message["args"] = draw.choices(ODD_ARGUMENTS, k=draw.randint(0, 3))
                case 3:
                    message["listener_id"] = draw.choice(self.listeners)[1]
                case _:
                    message["args"] = [json.dumps(draw.choice(ODD))] * draw.randint(0, 3)
        return message

    def say(self, socket: str, name: str, message: Any) -> None:
        self._handlers[name](socket, message)


async def orders_after(
    monkeypatch: pytest.MonkeyPatch, socket: str, count: int, *, is_mine: bool
) -> list[dict[str, Any]]:
    monkeypatch.setattr(core, "loop", asyncio.get_running_loop())  # else what a button does never begins
    page, draw = OpenPage(monkeypatch, is_mine=is_mine), random.Random(7)
    page.say(socket, "event", page.click())
    page.say(socket, "event", DEEP)
    for _ in range(count):
        page.say(socket, draw.choice((*FROM_PAGES, "event", "event")), page.mutant(draw))
        await asyncio.sleep(0)
    await asyncio.sleep(0)
    return page.orders


def of_who_may_not(monkeypatch: pytest.MonkeyPatch, socket: str, count: int) -> list[dict[str, Any]]:
    """Orders after spoilt messages by somebody else at the operator's page, or at a page without the seat."""
    is_mine = socket == "his"
    return asyncio.run(orders_after(monkeypatch, socket, count, is_mine=is_mine))


def test_a_click_of_the_operator_is_an_order(monkeypatch: pytest.MonkeyPatch) -> None:
    orders = asyncio.run(orders_after(monkeypatch, "hers", 0, is_mine=True))
    assert orders == [{"kind": "next", "upcoming": "image"}]


@pytest.mark.parametrize("socket", ["hers", "his"])
def test_two_thousand_spoilt_messages_give_no_order(monkeypatch: pytest.MonkeyPatch, socket: str) -> None:
    assert of_who_may_not(monkeypatch, socket, 2000) == []


@pytest.mark.soak
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("socket", ["hers", "his"])
def test_a_hundred_thousand_spoilt_messages_give_no_order(
    monkeypatch: pytest.MonkeyPatch, socket: str
) -> None:
    assert of_who_may_not(monkeypatch, socket, 100_000) == []
