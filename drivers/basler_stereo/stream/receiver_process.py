"""The reception process: `python -P -m drivers.basler_stereo.stream.receiver_process FD`.

Started by the driver only. It receives both cameras' streams, so that a driver that stalls loses no packet.
The channel FD carries orders; when it closes, the driver is gone.
"""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import socket
import sys

from drivers.basler_stereo.stream.receiver_loop import ReceiverLoop

EXIT_NOT_STARTED = 2
NICENESS = -10  # packets wait for nobody: the socket holds less than a tenth of a second of them


def main(arguments: list[str]) -> int:
    """Serve until the driver is gone; 2 when this was not started by it."""
    try:
        orders = socket.socket(fileno=int(arguments[0]))
    except (IndexError, ValueError, OSError) as error:
        print(f"this process is started by the driver only: {error}", file=sys.stderr)  # noqa: T201
        return EXIT_NOT_STARTED
    # an interrupt on the terminal goes to the whole group; the driver decides what it means
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(OSError):  # only the superuser may; without it a busy computer repairs more
        os.nice(NICENESS)
    gc.freeze()
    ReceiverLoop(orders).run()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
