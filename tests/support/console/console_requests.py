"""A console's guard and order routes in process, asked as by a browser, a script and an attacker."""

from __future__ import annotations

import asyncio
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.routing import WebSocketRoute
from starlette.websockets import WebSocket

from console.app import add_order_routes
from console.guard import AccessGuard, Sessions
from console.hub import Hub
from procedures.runs.operator_station import OperatorStation
from procedures.runs.orders import OrderReply, SentOrder

PORT = 8765
HOST = f"127.0.0.1:{PORT}"
ORIGIN = f"http://{HOST}"
SOCKET = "/_nicegui_ws/socket.io/"


@dataclass
class Response:
    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def refused(self) -> str:
        return str(json.loads(self.body)["refused"])


@dataclass
class Console:
    """A guarded console whose engine is a station in the same process."""

    station: OperatorStation = field(default_factory=lambda: OperatorStation(waits=False))
    sessions: Sessions = field(default_factory=Sessions)
    reached: list[str] = field(default_factory=list)  # paths that came through the guard

    def __post_init__(self) -> None:
        self.hub = Hub(Path("nowhere"))
        app = Starlette(routes=[WebSocketRoute(SOCKET, self._socket)])
        add_order_routes(app, self.hub)
        app.add_route("/", self._page, methods=["GET"])
        self.app = AccessGuard(app, self.sessions, PORT)  # type: ignore[arg-type]  # Starlette names its scope otherwise

        async def send(order: SentOrder) -> None:
            self.hub.reply(OrderReply(nonce=order.nonce, refused=self.station.take(order)))

        self.hub.connect(send)

    async def _page(self, request: Request) -> PlainTextResponse:
        self.reached.append(request.url.path)
        return PlainTextResponse("the page")

    async def _socket(self, socket: WebSocket) -> None:
        self.reached.append(SOCKET)
        await socket.accept()
        await socket.close()

    def cookie(self, token: str) -> str:
        """What a browser sends after it opened the address with that token."""
        answer = self.request("GET", "/", query=f"token={token}")
        return answer.headers["set-cookie"].split(";")[0]

    def operator(self) -> str:
        return self.cookie(self.sessions.operator_token)

    def viewer(self) -> str:
        return self.cookie(self.sessions.viewer_token)

    def order(self, cookie: str, **order: Any) -> Response:
        """An order as the page or a script gives it."""
        headers = {"cookie": cookie, "origin": ORIGIN}
        return self.request("POST", "/orders", headers=headers, body=json.dumps(order).encode())

    def request(
        self,
        method: str,
        path: str,
        *,
        query: str = "",
        headers: dict[str, str] | None = None,
        body: bytes = b"",
        host: str = HOST,
        length: bool = True,
    ) -> Response:
        """One HTTP request through the guard."""
        given = {"host": host, **(headers or {})}
        if body and length:
            given["content-length"] = str(len(body))
        scope = self._scope("http", path, query, given) | {"method": method}
        sent: list[Any] = []
        left = [body]

        async def receive() -> dict[str, Any]:
            if left:
                return {"type": "http.request", "body": left.pop(), "more_body": False}
            return {"type": "http.disconnect"}

        async def send(message: Any) -> None:
            sent.append(message)

        asyncio.run(self._run(scope, receive, send))
        start = sent[0]
        return Response(
            start["status"],
            {name.decode().lower(): value.decode() for name, value in start["headers"]},
            b"".join(message.get("body", b"") for message in sent[1:]),
        )

    def open_socket(self, headers: dict[str, str], host: str = HOST) -> bool:
        """Whether a WebSocket was accepted."""
        scope = self._scope("websocket", SOCKET, "", {"host": host, **headers}) | {"subprotocols": []}
        sent: list[Any] = []

        async def receive() -> dict[str, Any]:
            return {"type": "websocket.connect"}

        async def send(message: Any) -> None:
            sent.append(message)

        asyncio.run(self._run(scope, receive, send))
        return bool(sent[0]["type"] == "websocket.accept")

    async def _run(self, scope: Any, receive: Any, send: Any) -> None:
        await self.app(scope, receive, send)

    @staticmethod
    def _scope(kind: str, path: str, query: str, headers: dict[str, str]) -> dict[str, Any]:
        return {
            "type": kind,
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "scheme": "http" if kind == "http" else "ws",
            "path": path,
            "raw_path": path.encode(),
            "root_path": "",
            "query_string": query.encode(),
            "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
            "client": ("127.0.0.1", 40000),
            "server": ("127.0.0.1", PORT),
        }
