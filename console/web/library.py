"""The page library as used by both programs: its style, its settings, and the check of its sockets."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI, Request
from fastapi.responses import PlainTextResponse
from nicegui import app as page_app
from nicegui import core, ui

from console.web.sockets import bind_sockets

HERE = Path(__file__).parent
RECONNECT_S = 10.0  # as long as the seat is kept: a busy computer may delay a page for seconds
RESENT_MESSAGES = 400  # within that time, at the rate of an operator's page; otherwise the page is reloaded


def use_library(app: FastAPI, title: str, reconnect_s: float = RECONNECT_S) -> None:
    """Serve the pages added to an application. `title` is the same for every patient.

    A page that has not been heard from for `reconnect_s` of host time is rebuilt.
    """
    ui.run_with(
        app,
        title=title,
        dark=None,
        tailwind=False,
        favicon=str(HERE / "icon.svg"),
        reconnect_timeout=reconnect_s,
        message_history_length=RESENT_MESSAGES,
        show_welcome_message=False,
        gzip_middleware_factory=None,
    )
    page_app.add_exception_handler(404, _not_found)
    page_app.config.socket_io_js_transports = ["websocket"]
    bind_sockets(core.sio)


async def _not_found(_request: Request, _error: Exception) -> PlainTextResponse:
    """In place of a whole page of the library's, which holds up everything else while it is made."""
    return PlainTextResponse("Not found.", 404)


def page_head() -> str:
    """Style and script common to all pages."""
    style = (HERE / "style.css").read_text(encoding="utf-8")
    script = (HERE / "fresh.js").read_text(encoding="utf-8")
    return f"<style>{style}</style><script>{script}</script>"
