"""Speed of this computer, by four loops that a case is made of: Python, NumPy, datagrams, process starts.

    python tools/budget/calibration.py [python|numpy|datagrams|starts]

Each loop does a fixed amount of work in a process of its own. A figure of the budget is a multiple of the
processor time of all four, measured before and after it: what a slow or busy machine adds, it adds to both.
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping

# About a quarter of a second each on the machine of the first figures.
ROUNDS, EXCHANGES, STARTS = 1_800, 20_000, 8
IMAGE, TAPS, PASSES = (1088, 2048), 9, 4  # pixels of a camera
TELEGRAM_BYTES = 512  # about as long as a telegram of RSI


def compute_in_python() -> None:
    """Encode, decode and sum up records, as drivers and the journal do."""
    for number in range(ROUNDS):
        rows = [{"number": number, "joints_rad": [0.1 * axis for axis in range(6)]} for _ in range(40)]
        text = json.dumps(rows)
        sum(sum(row["joints_rad"]) for row in json.loads(text))


def compute_in_numpy() -> None:
    """Smooth an image, as drawing and measuring do."""
    import numpy as np

    image = np.random.default_rng(1).random(IMAGE, dtype=np.float32)
    for _ in range(PASSES):
        image = np.mean([np.roll(image, tap, axis=1) for tap in range(TAPS)], axis=0)


def exchange_datagrams() -> None:
    """Send datagrams over loopback and receive them, as a lock-step cycle does."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        for end in (one, other):
            end.bind(("127.0.0.1", 0))
        telegram = bytes(TELEGRAM_BYTES)
        for _ in range(EXCHANGES):
            one.sendto(telegram, other.getsockname())
            other.sendto(other.recv(TELEGRAM_BYTES), one.getsockname())
            one.recv(TELEGRAM_BYTES)


def start_processes() -> None:
    """Start Python processes that do nothing."""
    for _ in range(STARTS):
        subprocess.run([sys.executable, "-c", ""], check=True)


LOOPS: Mapping[str, Callable[[], None]] = {
    "python": compute_in_python,
    "numpy": compute_in_numpy,
    "datagrams": exchange_datagrams,
    "starts": start_processes,
}

if __name__ == "__main__":
    for name in sys.argv[1:] or LOOPS:
        LOOPS[name]()
