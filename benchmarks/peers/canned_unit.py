"""A tracker unit with one canned reply, to isolate the cost of the line, the kernel and Python.

Argument: serial-pty, or a TCP endpoint to listen on. Every command gets the BX reply of one visible tool.
"""

from __future__ import annotations

import json
import os
import socket
import sys
import tty
from collections.abc import Callable

from sim.world.process import end_with_parent

LONGEST = 4096
CR = 13
REPLY = bytes.fromhex(
    "C4A52D0030430101010000803F0000000000000000000000000000284100"
    "00A2C10080BBC40000003E310000002C01000000001D2D"
)


def main() -> None:
    end_with_parent(lambda: os._exit(0))
    if sys.argv[1] == "serial-pty":
        near, far = os.openpty()
        tty.setraw(far)
        _print_ready(f"serial://{os.ttyname(far)}")
        _answer(lambda: os.read(near, LONGEST), lambda reply: os.write(near, reply))
    with socket.create_server(("127.0.0.1", 0)) as listener:
        _print_ready(f"tcp://127.0.0.1:{listener.getsockname()[1]}")
        host = listener.accept()[0]
        host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        _answer(lambda: host.recv(LONGEST), host.send)


def _print_ready(endpoint: str) -> None:
    print("READY " + json.dumps({"endpoint": endpoint}), flush=True)


def _answer(receive: Callable[[], bytes], send: Callable[[bytes], int]) -> None:
    while received := receive():
        for _ in range(received.count(CR)):
            send(REPLY)


if __name__ == "__main__":
    main()
