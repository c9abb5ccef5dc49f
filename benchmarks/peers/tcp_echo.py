"""A bare TCP echo, to isolate the cost of socket calls, kernel and Python. Argument: where to connect."""

from __future__ import annotations

import json
import os
import socket
import sys

from ronna_hw.endpoints import parse_endpoint
from sim.world.process import end_with_parent

LONGEST = 65535


def main() -> None:
    end_with_parent(lambda: os._exit(0))
    controller = parse_endpoint(sys.argv[1])
    with socket.create_connection((controller.host, controller.port)) as link:
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        print("READY " + json.dumps({"endpoint": sys.argv[1]}), flush=True)
        receive, send = link.recv, link.send
        while data := receive(LONGEST):
            send(data)


if __name__ == "__main__":
    main()
