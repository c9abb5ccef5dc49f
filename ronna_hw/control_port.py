"""Client for the control port of a simulated theatre or device.

The port speaks JSON lines over TCP, with one answer per line. The first line carries the token from the READY
line, `{"token": "..."}`. Requests follow: `{"do": "step", "name": "at_target:T1"}`, `{"do": "mount",
"number": 2}`, `{"do": "work", "task": "insert", ...}`, `{"do": "fault", "line": "now: ..."}`, `{"do":
"clear_faults"}`, `{"do": "missed_faults"}`. Drivers and steps do not use the port.
"""

from __future__ import annotations

import contextlib
import json
import socket
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from ronna_hw.bounded_input import parse_json
from ronna_hw.endpoints import BadEndpoint, Endpoint, parse_endpoint
from ronna_hw.errors import ConfigurationError, ConnectError, ErrorCode
from ronna_hw.text import printable

ANSWER_LIMIT_S = 5.0  # host time
VARIABLE = "RONNA_CONTROL"  # in the environment: the address, for programs that are given none
LONGEST_LINE = 16 * 1024  # bytes, of a request or an answer
TOKEN_KEY = "token"
_TOKEN_MARK = f"?{TOKEN_KEY}="


class ControlPortSilent(ConnectError):
    """No simulated theatre or device answers at the control port."""

    code = "CTL-001"
    action = (
        'Set it anew: eval "$(ronna-sim env CELL)", or copy it from the READY line; if that program '
        "has ended, start it again."
    )


class ControlRequestRefused(ConfigurationError):
    """A simulated theatre or device refused a request at its control port."""

    code = "CTL-002"
    action = "Correct what is named; a token is copied with the whole endpoint, from the READY line."


CONTROL_PORT_OF_ANOTHER = ErrorCode(
    "CTL-003",
    ConfigurationError,
    "The control port belongs to another simulated theatre than the theatre file.",
    'Set it anew: eval "$(ronna-sim env THEATRE-FOLDER)" with the folder of the theatre file.',
)


TRUTH_IS_TOLD = ErrorCode(
    "CTL-004",
    ConfigurationError,
    "A run was to be made in a simulated theatre that tells the truth about its room.",
    "Start the theatre without --tell-truth for a run; `simulated_theatre` in Python is for studies alone.",
)


@dataclass(frozen=True)
class ControlAddress:
    """Address of a control port, including its token: `tcp://127.0.0.1:PORT?token=...`."""

    endpoint: Endpoint
    token: str = field(repr=False)

    @classmethod
    def parse(cls, text: str) -> ControlAddress:
        """Parse an address; raises CFG-002, without revealing the token, if it is invalid."""
        location, _, token = text.partition(_TOKEN_MARK)
        endpoint = parse_endpoint(location).require("tcp")
        if not token:
            raise BadEndpoint(
                f"{endpoint} has no token",
                expected=f"tcp://host:port{_TOKEN_MARK}...",
                action="Copy the whole control endpoint from the READY line, in quotes.",
            )
        return cls(endpoint, token)

    def text(self) -> str:
        """Complete address with its secret token, for the READY line."""
        return f"{self.endpoint}{_TOKEN_MARK}{self.token}"


class ControlPortClient:
    """Connection to a control port. The server closes it after a while without requests.

    Raises CTL-001 when nothing answers, CTL-002 for a wrong token, CFG-002 for another form of address.
    """

    def __init__(self, address: str) -> None:
        found = ControlAddress.parse(address)
        self._endpoint = str(found.endpoint)
        try:
            place = (found.endpoint.host, found.endpoint.port)
            self._socket = socket.create_connection(place, ANSWER_LIMIT_S)
        except OSError as error:
            raise self._silence_error(error) from error
        try:
            self._exchange("the token", {TOKEN_KEY: found.token})
        except BaseException:  # whatever happened: no one else knows of this connection
            self.close()
            raise

    def ask(self, action: str, **arguments: Any) -> dict[str, Any]:
        """Send a request and return the answer; raises CTL-001 if none arrives, CTL-002 if refused."""
        return self._exchange(action, {"do": action, **arguments})

    def close(self) -> None:
        """Close the connection; never raises."""
        with contextlib.suppress(OSError):
            self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _exchange(self, what: str, request: dict[str, Any]) -> dict[str, Any]:
        try:
            line = json.dumps(request, allow_nan=False).encode() + b"\n"
        except ValueError as error:
            raise ControlRequestRefused(f"{what} is refused: a number is not finite") from error
        try:
            self._socket.sendall(line)
            answer = parse_json(self._receive_answer() or b"{}")
        except (OSError, ValueError) as error:
            raise self._silence_error(error) from error
        if not isinstance(answer, dict):
            raise self._silence_error("what answers is no control port")
        if not answer:
            raise self._silence_error("the connection was closed")
        if not answer.get("ok"):
            reason = answer.get("reason", "no reason given")
            raise ControlRequestRefused(f"{what} is refused: {reason}", action=str(answer.get("advice", "")))
        return answer

    def _receive_answer(self) -> bytes:
        """Receive one line within a total time limit, or part of it if the server hangs up."""
        deadline_s = time.monotonic() + ANSWER_LIMIT_S
        line = bytearray()
        while b"\n" not in line and len(line) < LONGEST_LINE:
            if (remaining_s := deadline_s - time.monotonic()) <= 0:
                raise TimeoutError("timed out")
            self._socket.settimeout(remaining_s)
            if not (part := self._socket.recv(LONGEST_LINE - len(line))):
                break
            line += part
        self._socket.settimeout(ANSWER_LIMIT_S)
        return bytes(line)

    def _silence_error(self, reason: object) -> ControlPortSilent:
        words = reason.strerror if isinstance(reason, OSError) and reason.strerror else reason
        return ControlPortSilent(f"no answer from the control port {self._endpoint}: {words}")


def require_theatre(address: str, identity: str, file: Path) -> None:
    """Raise CTL-003 unless the port is that of the theatre with this identity, from its theatre `file`."""
    answer = ask_control_port(address, "identify")
    if answer.get("identity") != identity:
        raise CONTROL_PORT_OF_ANOTHER(
            f"the control port is of another theatre than {file}",
            expected=f"the port of the theatre in {file.resolve().parent}",
            got=f"that of {printable(str(answer.get('folder'))) or 'a simulator alone'}",
        )


def ask_control_port(address: str, action: str, **arguments: Any) -> dict[str, Any]:
    """Send a single request over its own connection; raises CTL-001, CTL-002 or CFG-002."""
    with ControlPortClient(address) as port:
        return port.ask(action, **arguments)
