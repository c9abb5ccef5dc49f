"""`GET /state` and `POST /orders`: the page's buttons for scripts, with the same checks and messages."""

from __future__ import annotations

from typing import Any

from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse

from console.guard import SESSION
from console.hub import Hub
from console.sessions import Role
from procedures.engine.events.event_types import shown_digest
from procedures.runs.orders import LONGEST_BYTES
from ronna_hw.bounded_input import parse_json


def add_order_routes(app: Any, hub: Hub) -> None:
    """Add both routes to a Starlette application."""

    async def state(_request: Request) -> JSONResponse:
        return JSONResponse(_state(hub))

    async def orders(request: Request) -> JSONResponse:
        session = request.scope[SESSION]
        if session.role is not Role.OPERATOR:
            return JSONResponse({"refused": "viewers cannot give orders"}, 403)
        try:
            content = parse_json(await request.body(), LONGEST_BYTES)
            refused = await hub.order(session, dict(content))
        except (ValueError, TypeError, ClientDisconnect):
            return JSONResponse({"refused": "not a valid order"}, 400)
        return JSONResponse({"refused": refused}, 409 if refused else 200)

    app.add_route("/state", state, methods=["GET"])
    app.add_route("/orders", orders, methods=["POST"])


def _state(hub: Hub) -> dict[str, Any]:
    view = hub.view
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
        "question": None
        if question is None
        else {
            "question": question.question,
            "topic": question.topic,
            "subject": question.subject,
            "value": question.value,
            "answers": question.answers,
            "read_back": question.read_back,
            "reads": question.reads,
            "shown": shown_digest(question),
        },
        "frozen": hub.frozen,
        "outcome": view.outcome,
    }
