"""A request to the control port of a running theatre or simulator."""

from __future__ import annotations

import json
import socket
from typing import Any

from ronna_hw.endpoints import parse_endpoint
from sim.errors import RoomRefused, RoomSilent

CONTROL_LIMIT_S = 5.0  # host time, for an answer of the control port


def ask_room(control: str, request: dict[str, Any]) -> None:
    """Have the room do something; raises SIM-008 when nobody answers, SIM-009 when it is refused."""
    address = parse_endpoint(control).require("tcp")
    try:
        with socket.create_connection((address.host, address.port), CONTROL_LIMIT_S) as door:
            door.sendall(json.dumps(request).encode() + b"\n")
            answer = json.loads(door.makefile("rb").readline() or b"{}")
    except (OSError, ValueError) as error:
        raise RoomSilent(f"no theatre answers at {control}: {error}") from error
    if not answer.get("ok"):
        raise RoomRefused(str(answer.get("reason", "no answer")))
