"""The receiver process: `python -P -m drivers.basler_stereo.stream.receiver_process FD`.

Started only by the driver. It receives both cameras' streams, so that a stalled driver loses no packets. The
channel FD carries orders; when it closes, the driver is gone. It never sees Ctrl-C: the driver started it in
a session of its own with SIGINT blocked.
"""

from __future__ import annotations

import contextlib
import gc
import os
import socket
import sys

from drivers.basler_stereo.stream.receiver_loop import ReceiverLoop

EXIT_NOT_STARTED = 2
NICENESS = -10  # the socket buffers less than a tenth of a second of packets


def main(arguments: list[str]) -> int:
    """Serve until the driver is gone; returns 2 if not started by it."""
    try:
        orders = socket.socket(fileno=int(arguments[0]))
    except (IndexError, ValueError, OSError) as error:
        print(f"this process is started by the driver only: {error}", file=sys.stderr)  # noqa: T201
        return EXIT_NOT_STARTED
    with contextlib.suppress(OSError):  # superuser only; otherwise a busy computer loses more packets
        os.nice(NICENESS)
    gc.freeze()
    ReceiverLoop(orders).run()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
