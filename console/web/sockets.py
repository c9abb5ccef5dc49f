"""Binds messages on a socket to the session that owns its page.

The page library accepts a message from any socket for the page named in it. Here a socket may only address
pages of its own session, and malformed messages are dropped.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from urllib.parse import parse_qs

from console.guard import SESSION

FROM_PAGES = ("event", "javascript_response", "ack", "log")

_owners: dict[str, str] = {}  # page -> session; the library's own pages are also global


def own_page(client: Any, session: str) -> None:
    """From now on only sockets of that session may address this page."""
    _owners[client.id] = session
    client.on_delete(lambda: _owners.pop(client.id, None))


def bind_sockets(sio: Any) -> None:
    """Insert the check before the handlers of the page library."""
    handlers = sio.handlers["/"]
    for name in FROM_PAGES:
        sio.on(name, _checked(sio, handlers[name]))
    handshake, connect = handlers["handshake"], handlers["connect"]

    async def checked_handshake(sid: str, data: Any = None) -> bool:
        if not isinstance(data, dict) or not _may_speak(sio, sid, data.get("client_id")):
            return False
        return bool(await handshake(sid, data))

    async def checked_connect(sid: str, environ: dict[str, Any], auth: Any = None) -> Any:
        named = parse_qs(environ.get("QUERY_STRING", "")).get("client_id", [""])[0]
        if named and _owners.get(named) not in (None, _session_of(environ)):
            return False
        return await connect(sid, environ, auth)

    sio.on("handshake", checked_handshake)
    sio.on("connect", checked_connect)


def _checked(sio: Any, inner: Callable[[str, Any], Any]) -> Callable[..., None]:
    def checked(sid: str, message: Any = None, *_more: Any) -> None:
        if not isinstance(message, dict) or not _may_speak(sio, sid, message.get("client_id")):
            return
        try:
            inner(sid, message)
        except (KeyError, TypeError, ValueError, AttributeError, IndexError):
            return

    return checked


def _may_speak(sio: Any, sid: str, client: Any) -> bool:
    if not isinstance(client, str) or client not in _owners:
        return False
    environ = sio.get_environ(sid)
    return environ is not None and _owners[client] == _session_of(environ)


def _session_of(environ: dict[str, Any]) -> str | None:
    session = environ.get("asgi.scope", {}).get(SESSION)
    return None if session is None else str(session.identifier)
