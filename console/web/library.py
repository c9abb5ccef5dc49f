"""The page library as both programs use it: its style, its settings, and the check of its sockets."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI
from nicegui import app as page_app
from nicegui import core, ui

from console.web.sockets import bind_sockets

HERE = Path(__file__).parent
RECONNECT_S = 10.0  # as long as the seat is kept: a computer that is busy holds up a page for seconds
RESENT_MESSAGES = 400  # in as long, at the rate of an operator's page; else the page is loaded again


def use_library(app: FastAPI, title: str, reconnect_s: float = RECONNECT_S) -> None:
    """Serve the pages that were added by an application. `title` is the same for every patient.

    A page that was not heard of for `reconnect_s` of host time is built anew.
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
    page_app.config.socket_io_js_transports = ["websocket"]
    bind_sockets(core.sio)


def page_head() -> str:
    """Style and script that every page begins with."""
    style = (HERE / "style.css").read_text(encoding="utf-8")
    script = (HERE / "fresh.js").read_text(encoding="utf-8")
    return f"<style>{style}</style><script>{script}</script>"
