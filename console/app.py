"""The server of one run's console: guard, routes and pages on one loopback port."""

from __future__ import annotations

import asyncio
import json
import socket
import sys
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import uvicorn
from fastapi import FastAPI

from console.errors import PortTaken
from console.feed.engine_socket import follow_engine
from console.guard import LARGEST_BODY_BYTES, Guard
from console.hub import Hub
from console.orders_route import add_order_routes
from console.sessions import Sessions
from console.web.page import add_page

AFTER_CLOSED_S = 2.0  # host time for the pages to show the end of a case
AFTER_LOST_S = 60.0  # host time in which the last picture of a case that broke off can be looked at
HOST = "127.0.0.1"
BACKLOG = 64
SOCKET_BYTES = 4 * LARGEST_BODY_BYTES  # the page library sends some messages of its own
Work = Callable[[], Coroutine[Any, Any, None]]


def serve(folder: Path, port: int, *, feed: int) -> None:
    """Serve the console of a running case until the engine has ended. Raises CON-001."""
    hub = Hub(folder)

    async def work() -> None:
        await follow_engine(feed, hub)
        await asyncio.sleep(AFTER_CLOSED_S if hub.view.outcome else AFTER_LOST_S)

    serve_hub(hub, port, work, _print_ready)


def _print_ready(ready: dict[str, str]) -> None:
    sys.stdout.write(f"READY {json.dumps(ready)}\n")
    sys.stdout.flush()


def serve_hub(hub: Hub, port: int, work: Work | None, ready: Callable[[dict[str, str]], None]) -> None:
    """Serve a case until `work` is done, or without it until the process is ended. Raises CON-001."""
    serve_pages(lambda app: _add_case(app, hub), port, work, ready)


def serve_pages(
    add: Callable[[FastAPI], None], port: int, work: Work | None, ready: Callable[[dict[str, str]], None]
) -> None:
    """Serve what `add` adds to an application, behind the guard, as `serve_hub`. Raises CON-001."""
    listening = _listen(port)
    port = listening.getsockname()[1]
    sessions = Sessions()
    server = uvicorn.Server(
        uvicorn.Config(
            _guarded(add, sessions, port),
            log_config=None,
            access_log=False,  # an address may hold a key
            lifespan="on",
            ws_max_size=SOCKET_BYTES,
            ws_per_message_deflate=False,  # nothing is far away
            timeout_graceful_shutdown=1,
            server_header=False,
        )
    )

    async def run() -> None:
        serving = asyncio.create_task(server.serve(sockets=[listening]))
        while not server.started and not serving.done():
            await asyncio.sleep(0.01)
        address = f"http://{HOST}:{port}/?token="
        ready({"url": address + sessions.operator_token, "viewer_url": address + sessions.viewer_token})
        if work is not None:
            await work()
            server.should_exit = True
        await serving

    asyncio.run(run())


def _guarded(add: Callable[[FastAPI], None], sessions: Sessions, port: int) -> Guard:
    app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
    add(app)
    return Guard(app, sessions, port)


def _add_case(app: FastAPI, hub: Hub) -> None:
    add_order_routes(app, hub)
    add_page(app, hub)


def _listen(port: int) -> socket.socket:
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((HOST, port))
    except OSError as error:
        listening.close()
        raise PortTaken(f"port {port} of {HOST} cannot be used: {error.strerror}") from error
    listening.listen(BACKLOG)
    return listening
