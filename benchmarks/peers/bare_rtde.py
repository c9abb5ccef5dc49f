"""A bare client of RTDE: receives, unpacks, packs and sends, and decides nothing. Argument: where to connect.

Its packages have the fields and sizes of the driver's: what is left is the least that Python needs.
"""

from __future__ import annotations

import json
import os
import socket
import sys

from drivers.universal_robots.realtime.packages import ACTUAL, OUTPUT, RUN, encode_input
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.wire.universal_robots import ScriptOrder
from sim.world.process import end_with_parent

RECIPE, NO_SET_POINT = 1, 0


def main() -> None:
    end_with_parent(lambda: os._exit(0))
    controller = parse_endpoint(sys.argv[1])
    buffer = bytearray(OUTPUT.size)
    with socket.create_connection((controller.host, controller.port)) as link:
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        print("READY " + json.dumps({"endpoint": sys.argv[1]}), flush=True)
        receive, send, unpack = link.recv_into, link.send, OUTPUT.unpack_from
        while receive(buffer) == OUTPUT.size:
            values = unpack(buffer)
            send(encode_input(RECIPE, NO_SET_POINT, ScriptOrder.STREAM, int(values[RUN]), values[ACTUAL]))


if __name__ == "__main__":
    main()
