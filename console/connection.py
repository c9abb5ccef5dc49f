"""One connection of the console's server: a request has little time to arrive.

The guard sees a request only after its head is complete, so incomplete heads are limited here.
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

REQUEST_LIMIT_S = 5.0  # host time, from the connection or the last answer to the complete next head
ANSWER_LIMIT_S = 60.0  # host time from there until the answer was taken: five megabytes by a slow line


class Connection(H11Protocol):
    """HTTP/1.1 that is dropped when the time for a head or for an answer is up, however either drips."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._deadline: asyncio.TimerHandle | None = None
        self._is_answering = False
        self._answer_ends_s = 0.0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as in uvicorn
        """Give the first request its time."""
        super().connection_made(transport)
        self._wait(REQUEST_LIMIT_S)

    def handle_events(self) -> None:
        """A complete head begins the time for its answer."""
        super().handle_events()
        if self.cycle is not None and not self.cycle.response_complete and not self._is_answering:
            self._is_answering = True
            self._answer_ends_s = self.loop.time() + ANSWER_LIMIT_S
            self._wait(ANSWER_LIMIT_S)

    def handle_websocket_upgrade(self, event: Any) -> None:
        """The guard closes a socket without a session, and leaves others open.

        A head that the socket's protocol refuses, for a long line, is neither answered nor seen by the guard.
        """
        self._stop_waiting()
        super().handle_websocket_upgrade(event)
        if not getattr(self.transport.get_protocol(), "handshake_initiated", False):
            self.transport.abort()

    def on_response_complete(self) -> None:
        """Give the next request its time."""
        self._is_answering = False
        self._wait(REQUEST_LIMIT_S)
        super().on_response_complete()

    def connection_lost(self, exc: Exception | None) -> None:
        """Leave no timer behind."""
        self._stop_waiting()
        super().connection_lost(exc)

    def _wait(self, limit_s: float) -> None:
        self._stop_waiting()
        self._deadline = self.loop.call_later(limit_s, self._end)

    def _end(self) -> None:
        """An answer that was sent whole may still be on its way to a slow reader."""
        left_s = self._answer_ends_s - self.loop.time()
        if left_s > 0.0 and not self._is_answering and self.transport.get_write_buffer_size() > 0:
            self._wait(min(left_s, REQUEST_LIMIT_S))
        else:
            self.transport.abort()

    def _stop_waiting(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
