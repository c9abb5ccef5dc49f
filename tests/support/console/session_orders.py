"""Orders that a session of the console gives to a station."""

from __future__ import annotations

import itertools
import json
from typing import Any

from procedures.runs.operator_station import OperatorStation
from procedures.runs.orders import read_order

ANA = "session-ana"


class SessionOrders:
    """Gives orders as they are sent, each with a nonce of its own, and returns why one is refused."""

    def __init__(self, station: OperatorStation) -> None:
        self._station = station
        self._numbers = itertools.count(1)

    def __call__(self, kind: str, session: str = ANA, **more: Any) -> str:
        content = {"kind": kind, "session": session, "nonce": f"nonce-{next(self._numbers):03}", **more}
        return self._station.take(read_order(json.dumps(content)))
