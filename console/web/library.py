"""Page-library setup shared by console and planner: style, settings, and socket checks.

The library accepts a message from any socket for the page named in it. Here a socket may only address pages
of its own session, and malformed messages are dropped.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

from fastapi import FastAPI, Request
from fastapi.responses import PlainTextResponse
from nicegui import app as page_app
from nicegui import core, ui

from console.guard import SESSION

FROM_PAGES = ("event", "javascript_response", "ack", "log")
_owners: dict[str, str] = {}  # page -> session; the library's own pages are also global
FOLDER = Path(__file__).parent
RECONNECT_S = 10.0  # as long as the seat is kept: a busy computer may delay a page for seconds
RESENT_MESSAGES = 400  # within that time, at the rate of an operator's page; otherwise the page is reloaded


def use_library(app: FastAPI, title: str, reconnect_s: float = RECONNECT_S) -> None:
    """Serve the pages added to an application. `title` must not depend on the patient.

    A page that has not been heard from for `reconnect_s` of host time is rebuilt.
    """
    ui.run_with(
        app,
        title=title,
        dark=None,
        tailwind=False,
        favicon=str(FOLDER / "icon.svg"),
        reconnect_timeout=reconnect_s,
        message_history_length=RESENT_MESSAGES,
        show_welcome_message=False,
        gzip_middleware_factory=None,
    )
    page_app.add_exception_handler(404, _not_found)
    page_app.config.socket_io_js_transports = ["websocket"]
    bind_sockets(core.sio)


def page_head() -> str:
    """Return the style and script common to all pages."""
    style = (FOLDER / "style.css").read_text(encoding="utf-8")
    script = (FOLDER / "fresh.js").read_text(encoding="utf-8")
    return f"<style>{style}</style><script>{script}</script>"


async def _not_found(_request: Request, _error: Exception) -> PlainTextResponse:
    """Answer 404 in plain text, since the library's own page would block everything else."""
    return PlainTextResponse("Not found.", 404)


def bind_page(client: Any, session: str) -> None:
    """Bind a page to a session, so that sockets of other sessions can no longer address it."""
    _owners[client.id] = session
    client.on_delete(lambda: _owners.pop(client.id, None))


def bind_sockets(sio: Any) -> None:
    """Insert the session check before the page library's socket handlers."""
    handlers = sio.handlers["/"]
    for name in FROM_PAGES:
        sio.on(name, _with_check(sio, handlers[name]))
    handshake, connect = handlers["handshake"], handlers["connect"]

    async def handle_handshake(sid: str, data: Any = None) -> bool:
        if not isinstance(data, dict) or not _may_speak(sio, sid, data.get("client_id")):
            return False
        return bool(await handshake(sid, data))

    async def handle_connect(sid: str, environ: dict[str, Any], auth: Any = None) -> Any:
        page_name = parse_qs(environ.get("QUERY_STRING", "")).get("client_id", [""])[0]
        if page_name and _owners.get(page_name) not in (None, _find_session(environ)):
            return False
        return await connect(sid, environ, auth)

    sio.on("handshake", handle_handshake)
    sio.on("connect", handle_connect)


def _with_check(sio: Any, inner: Callable[[str, Any], Any]) -> Callable[..., None]:
    def call_checked(sid: str, message: Any = None, *_more: Any) -> None:
        if not isinstance(message, dict) or not _may_speak(sio, sid, message.get("client_id")):
            return
        try:
            inner(sid, message)
        except (KeyError, TypeError, ValueError, AttributeError, IndexError):
            return

    return call_checked


def _may_speak(sio: Any, sid: str, client: Any) -> bool:
    if not isinstance(client, str) or client not in _owners:
        return False
    environ = sio.get_environ(sid)
    return environ is not None and _owners[client] == _find_session(environ)


def _find_session(environ: dict[str, Any]) -> str | None:
    session = environ.get("asgi.scope", {}).get(SESSION)
    return None if session is None else str(session.identifier)
