"""The control port of a simulated theatre or device, as its callers use it.

JSON lines over TCP, one answer per request: `{"do": "step", "name": "at_target:T1"}`,
`{"do": "mount", "number": 2}`, `{"do": "fault", "line": "now: ..."}`, `{"do": "clear_faults"}`. READY lines
tell where the port is. No driver and no step knows of it.
"""

from __future__ import annotations

import contextlib
import json
import socket
from typing import Any, Self

from ronna_hw.endpoints import parse_endpoint
from ronna_hw.errors import ConfigurationError, ConnectError

ANSWER_LIMIT_S = 5.0  # host time


class ControlPortSilent(ConnectError):
    """No theatre or simulated device answers at the control port."""

    code = "CTL-001"
    action = "Give the control endpoint of its READY line; start it again if it has ended."


class ControlRequestRefused(ConfigurationError):
    """A running theatre or simulated device refused a request at its control port."""

    code = "CTL-002"
    action = "See ronna-sim mount --help, or run ronna-sim fault to list all kinds of fault."


class ControlPortClient:
    """One connection. Raises CTL-001 when nobody answers, CFG-002 for anything but tcp://host:port."""

    def __init__(self, endpoint: str) -> None:
        address = parse_endpoint(endpoint).require("tcp")
        self._endpoint = endpoint
        try:
            self._socket = socket.create_connection((address.host, address.port), ANSWER_LIMIT_S)
        except OSError as error:
            raise self._silent(error) from error
        self._answers = self._socket.makefile("rb")

    def ask(self, action: str, **arguments: Any) -> None:
        """Have something done; raises CTL-001 when no answer comes, CTL-002 with the reason of a refusal."""
        request = json.dumps({"do": action, **arguments}).encode()
        try:
            self._socket.sendall(request + b"\n")
            answer = json.loads(self._answers.readline() or b"{}")
        except (OSError, ValueError) as error:
            raise self._silent(error) from error
        if not answer:
            raise self._silent("the connection was closed")
        if not answer.get("ok"):
            raise ControlRequestRefused(f"{action} is refused: {answer.get('reason', 'no reason given')}")

    def close(self) -> None:
        """Hang up; never raises."""
        with contextlib.suppress(OSError):
            self._answers.close()
            self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _silent(self, reason: object) -> ControlPortSilent:
        return ControlPortSilent(f"no answer at the control port {self._endpoint}: {reason}")


def ask_control_port(endpoint: str, action: str, **arguments: Any) -> None:
    """One request on a connection of its own; raises CTL-001 or CTL-002."""
    with ControlPortClient(endpoint) as port:
        port.ask(action, **arguments)
