"""Web server of the console: a running case over the engine's socket, a recorded case, or other pages.

`GET /state` and `POST /orders` offer the page's buttons to scripts, with the same checks and messages. A
recorded case, or one run by another program, has a slider through its time.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import socket
import sys
import threading
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse

from console.errors import NOTHING_TO_SHOW
from console.guard import LARGEST_BODY_BYTES, SESSION, AccessGuard, SessionRole, Sessions
from console.hub import Hub
from console.listening import HOST, build_server, listen
from console.recorded_case import RecordedCase
from console.web.page import add_page
from procedures.engine.events import Event
from procedures.engine.events.event_file import FollowedRun
from procedures.engine.events.event_types import digest_of_question
from procedures.operator.question import Identity
from procedures.reporting.ending import await_ending, read_ending
from procedures.runs.orders import LONGEST_BYTES, OrderReply, SentOrder
from ronna_hw.bounded_input import parse_json
from ronna_hw.command_line.messages import tell_address
from ronna_hw.command_line.viewers_address import ViewersAddress
from ronna_hw.errors import RonnaError

LONGEST_LINE = 1 << 22  # bytes; a question with its tables takes some thousand, an image some 100,000
PAIR, IDENTITY = b'{"pair":"', b'{"identity":'
ASKED = {"question", "topic", "subject", "value", "answers", "read_back", "reads"}  # of a question, as state
AFTER_CLOSED_S = 2.0  # host time for which pages show the end of a case
AFTER_LOST_S = 60.0  # host time for which the last state of a case that broke off stays visible
Work = Callable[[], Coroutine[Any, Any, None]]


def serve(folder: Path, port: int, *, feed: int, viewers: ViewersAddress | None = None) -> None:
    """Serve the console of a running case until the engine has ended. Raises CON-001."""
    hub = Hub(folder)

    async def work() -> None:
        await follow_engine(feed, hub)
        if hub.view.outcome:  # the engine's end of the socket is closed after the seal
            hub.take_ending(await asyncio.to_thread(read_ending, folder))
        await asyncio.sleep(AFTER_CLOSED_S if hub.view.outcome else AFTER_LOST_S)

    serve_hub(hub, port, work, _print_ready, viewers)


def review(folder: Path, port: int, viewers: ViewersAddress | None = None) -> None:
    """Serve a recorded run until the command ends. Raises CON-001, CON-002, PRO-018."""
    try:
        followed = FollowedRun(folder)
    except RonnaError as error:
        raise NOTHING_TO_SHOW(f"{folder} contains no run that can be shown: {error.what}") from error
    batches = followed.batches(whole=True)
    recorded, hub = RecordedCase(), Hub(folder)
    recorded.extend(next(batches))
    if not len(recorded):
        raise NOTHING_TO_SHOW(f"{folder} has no events yet")
    hub.review = recorded
    hub.show(recorded.latest)
    if followed.over:
        hub.take_ending(read_ending(folder))

    async def work() -> None:
        loop = asyncio.get_running_loop()

        def take(events: list[Event]) -> None:
            recorded.extend(events)
            hub.note_heartbeat()
            for event in events:
                hub.take(event)

        def follow() -> None:
            try:
                for events in batches:
                    loop.call_soon_threadsafe(take, list(events))
            except (RonnaError, OSError) as error:  # still being written; what was read before stays valid
                words = str(error) if isinstance(error, RonnaError) else f"{folder} cannot be read: {error}"
                loop.call_soon_threadsafe(hub.break_off, words)
            recorded.is_over = True
            loop.call_soon_threadsafe(hub.take_ending, await_ending(folder))

        threading.Thread(target=follow, name="follow the run", daemon=True).start()
        await asyncio.Event().wait()

    serve_hub(hub, port, work, tell_address, viewers)


def serve_hub(
    hub: Hub,
    port: int,
    work: Work | None,
    ready: Callable[[dict[str, str]], None],
    viewers: ViewersAddress | None = None,
) -> None:
    """Serve a case until `work` is done, or without `work` until the process ends. Raises CON-001.

    `viewers` watch from other computers, through a separate port.
    """

    def add(app: FastAPI) -> None:
        add_order_routes(app, hub)
        add_page(app, hub)

    serve_pages(add, port, work, ready, viewers)


def serve_pages(
    add: Callable[[FastAPI], None],
    port: int,
    work: Work | None,
    ready: Callable[[dict[str, str]], None],
    viewers: ViewersAddress | None = None,
    largest_body_bytes: int = LARGEST_BODY_BYTES,
) -> None:
    """Serve the routes added by `add`, behind the guard, as `serve_hub` does. Raises CON-001."""
    listening = listen(HOST, port)
    port = listening.getsockname()[1]
    sessions = Sessions()
    pages = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
    add(pages)
    guard = AccessGuard(pages, sessions, port, largest_body_bytes, listening.trust, listening.is_foreign)
    servers = [(build_server(guard), listening)]
    local = f"http://{HOST}:{port}/?token="
    addresses = {"url": local + sessions.operator_token, "viewer_url": local + sessions.viewer_token}
    if viewers is not None:
        viewer_socket = listen(viewers.address, 0, viewers.family)
        host = viewers.host(viewer_socket.getsockname()[1])
        servers.append((build_server(guard.viewer_guard(host, viewer_socket.trust), viewers), viewer_socket))
        addresses["remote_viewer_url"] = f"https://{host}/?token={sessions.viewer_token}"

    async def run() -> None:
        tasks = [asyncio.create_task(server.serve(sockets=[bound])) for server, bound in servers]
        while not all(server.started for server, _ in servers) and not any(task.done() for task in tasks):
            await asyncio.sleep(0.01)
        ready(addresses)
        if work is not None:
            await work()
            for server, _ in servers:
                server.should_exit = True
        await asyncio.gather(*tasks)

    asyncio.run(run())


async def follow_engine(descriptor: int, hub: Hub) -> None:
    """Feed the hub until the engine closes its end of the socket."""
    reader, writer = await asyncio.open_connection(sock=socket.socket(fileno=descriptor), limit=LONGEST_LINE)

    async def send(sent: SentOrder) -> None:
        writer.write(sent.model_dump_json().encode() + b"\n")
        await writer.drain()

    hub.connect(send)
    try:
        while line := await reader.readline():
            hub.note_heartbeat()
            _handle_line(hub, line)
            if hub.view.outcome and hub.ending is None:
                hub.take_ending(await asyncio.to_thread(read_ending, hub.folder))
    except (OSError, ValueError):
        pass  # not one of our lines, or longer than any: this is not our engine, and the page says so
    finally:
        hub.end()
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()


def _handle_line(hub: Hub, line: bytes) -> None:
    if line.startswith(b'{"event":'):
        hub.take(Event.model_validate_json(line.strip()[len(b'{"event":') : -1]))
    elif line.startswith(b'{"beat":'):
        hub.notify()
    elif line.startswith(IDENTITY):
        hub.take_identity(Identity.model_validate_json(line.strip()[len(IDENTITY) : -1]))
    elif line.startswith(PAIR):
        hub.take_pair(base64.b64decode(line.strip()[len(PAIR) : -2]))
    elif line.strip():
        hub.reply(OrderReply.model_validate(json.loads(line)))


def add_order_routes(app: Any, hub: Hub) -> None:
    """Add the `/state` and `/orders` routes to a Starlette application."""

    async def state(_request: Request) -> JSONResponse:
        return JSONResponse(_state_document(hub))

    async def orders(request: Request) -> JSONResponse:
        session = request.scope[SESSION]
        if session.role is not SessionRole.OPERATOR:
            return JSONResponse({"refused": "viewers cannot give orders"}, 403)
        try:
            content = parse_json(await request.body(), LONGEST_BYTES)
            refusal = await hub.order(session, dict(content))
        except (ValueError, TypeError, ClientDisconnect):
            return JSONResponse({"refused": "not a valid order"}, 400)
        return JSONResponse({"refused": refusal}, 409 if refusal else 200)

    app.add_route("/state", state, methods=["GET"])
    app.add_route("/orders", orders, methods=["POST"])


def _state_document(hub: Hub) -> dict[str, Any]:
    view = hub.told(hub.view)
    question = view.question
    return {
        "number": view.number,
        "run": view.run,
        "banner": view.banner,
        "state": view.state,
        "running": view.running,
        "waiting": view.waiting is not None,
        "upcoming": view.upcoming,
        "steps": {row.step: row.state for row in view.steps},
        "seat": view.seat.holder if view.seat else "",
        "question": question
        and {**question.model_dump(include=ASKED), "shown": digest_of_question(question)},
        "frozen": hub.frozen,
        "outcome": view.outcome,
    }


def _print_ready(ready: dict[str, str]) -> None:
    sys.stdout.write(f"READY {json.dumps(ready)}\n")
    sys.stdout.flush()
