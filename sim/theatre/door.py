"""A request to the control port of a running theatre or simulator."""

from __future__ import annotations

from typing import Any

from ronna_hw.control_port import ask_control_port


def ask_room(control: str, request: dict[str, Any]) -> None:
    """Have the room do something; raises CTL-001 when nobody answers, CTL-002 when it is refused."""
    arguments = {name: value for name, value in request.items() if name != "do"}
    ask_control_port(control, str(request["do"]), **arguments)
