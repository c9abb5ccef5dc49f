"""The server of one run's console: guard, routes and pages."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

from fastapi import FastAPI

from console.feed.engine_socket import follow_engine
from console.guard import LARGEST_BODY_BYTES, Guard
from console.hub import Hub
from console.listening import HOST, listen, server_of
from console.orders_route import add_order_routes
from console.sessions import Sessions
from console.web.page import add_page
from ronna_hw.command_line.viewers_address import ViewersAddress

AFTER_CLOSED_S = 2.0  # host time for which pages show the end of a case
AFTER_LOST_S = 60.0  # host time for which the last state of a case that broke off stays visible
Work = Callable[[], Coroutine[Any, Any, None]]


def serve(folder: Path, port: int, *, feed: int, viewers: ViewersAddress | None = None) -> None:
    """Serve the console of a running case until the engine has ended. Raises CON-001."""
    hub = Hub(folder)

    async def work() -> None:
        await follow_engine(feed, hub)
        await asyncio.sleep(AFTER_CLOSED_S if hub.view.outcome else AFTER_LOST_S)

    serve_hub(hub, port, work, _print_ready, viewers)


def _print_ready(ready: dict[str, str]) -> None:
    sys.stdout.write(f"READY {json.dumps(ready)}\n")
    sys.stdout.flush()


def serve_hub(
    hub: Hub,
    port: int,
    work: Work | None,
    ready: Callable[[dict[str, str]], None],
    viewers: ViewersAddress | None = None,
) -> None:
    """Serve a case until `work` is done, or without it until the process ends. Raises CON-001.

    `viewers` watch from other computers, through a separate port.
    """
    serve_pages(lambda app: _add_case(app, hub), port, work, ready, viewers)


def serve_pages(
    add: Callable[[FastAPI], None],
    port: int,
    work: Work | None,
    ready: Callable[[dict[str, str]], None],
    viewers: ViewersAddress | None = None,
    largest_body_bytes: int = LARGEST_BODY_BYTES,
) -> None:
    """Serve what `add` adds to an application, behind the guard, like `serve_hub`. Raises CON-001."""
    listening = listen(HOST, port)
    port = listening.getsockname()[1]
    sessions = Sessions()
    pages = _application(add)
    guard = Guard(pages, sessions, port, largest_body_bytes, listening.trust, listening.is_foreign)
    served = [(server_of(guard), listening)]
    local = f"http://{HOST}:{port}/?token="
    addresses = {"url": local + sessions.operator_token, "viewer_url": local + sessions.viewer_token}
    if viewers is not None:
        theirs = listen(viewers.address, 0, viewers.family)
        host = viewers.host(theirs.getsockname()[1])
        served.append((server_of(guard.for_viewers(host, theirs.trust), viewers), theirs))
        addresses["remote_viewer_url"] = f"https://{host}/?token={sessions.viewer_token}"

    async def run() -> None:
        tasks = [asyncio.create_task(server.serve(sockets=[bound])) for server, bound in served]
        while not all(server.started for server, _ in served) and not any(one.done() for one in tasks):
            await asyncio.sleep(0.01)
        ready(addresses)
        if work is not None:
            await work()
            for server, _ in served:
                server.should_exit = True
        await asyncio.gather(*tasks)

    asyncio.run(run())


def _application(add: Callable[[FastAPI], None]) -> FastAPI:
    app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
    add(app)
    return app


def _add_case(app: FastAPI, hub: Hub) -> None:
    add_order_routes(app, hub)
    add_page(app, hub)
