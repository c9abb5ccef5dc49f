"""Small cameras in processes of their own, for tests of the stereo driver over real sockets."""

from __future__ import annotations

import itertools
import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ronna_hw.devices.readings import AreaOfInterest

PEER = Path(__file__).with_name("peer_camera_process.py")
SERIALS = ("21900001", "21900002")
FULL = AreaOfInterest(0, 0, 256, 128)
HANG_LIMIT_S = 30.0  # this machine may stall; what takes longer hangs
_numbers = itertools.count(1)


def free_address() -> str:
    """A loopback address on which nobody has a camera's port."""
    while True:
        address = f"127.66.{os.getpid() % 250 + 1}.{next(_numbers) % 250 + 1}"
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind((address, 3956))
            except OSError:
                continue
            return address


class Peer:
    def __init__(self, serial: str, *options: str) -> None:
        self.address = free_address()
        self.serial = serial
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(PEER), self.address, serial, *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def ready(self) -> Peer:
        assert self._process.stdout.readline() == "READY\n"
        return self

    def fault(self, *words: object) -> str:
        self._process.stdin.write(" ".join(str(word) for word in words) + "\n")
        self._process.stdin.flush()
        return self._process.stdout.readline()

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        self._process.stdin.close()
        self._process.kill()
        self._process.wait()
        self._process.stdout.close()


def pattern(area: AreaOfInterest, block_id: int) -> NDArray[np.int64]:
    rows, columns = np.mgrid[: area.height, : area.width]
    return (columns + area.offset_x) + 3 * (rows + area.offset_y) + 7 * block_id
