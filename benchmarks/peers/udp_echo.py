"""A bare UDP echo server, to isolate the cost of the socket calls, the kernel and Python."""

from __future__ import annotations

import json
import os
import socket

from sim.world.process import end_with_parent

LONGEST = 65535


def main() -> None:
    end_with_parent(lambda: os._exit(0))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        print("READY " + json.dumps({"endpoint": f"udp://127.0.0.1:{link.getsockname()[1]}"}), flush=True)
        receive, send = link.recvfrom, link.sendto
        while True:
            send(*receive(LONGEST))


if __name__ == "__main__":
    main()
